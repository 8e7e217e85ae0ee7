"""Everything that the user can do: one file per step of the panel."""

from . import regions, results, scene, select, train

OPERATORS = (scene, regions, select, train, results)
