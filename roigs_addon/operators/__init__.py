"""Everything that the user can do: one file per step of the panel."""
