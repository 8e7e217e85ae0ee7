"""Everything that the user can do: one file per step of the panel."""

from . import engine_setup, regions, results, scene, select, train

OPERATORS = (engine_setup, scene, regions, select, train, results)
