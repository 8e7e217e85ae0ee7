"""What the user can do; one file for each step of the panel."""
