"""Step 5, Result: confidence of each Gaussian, as a heat map and as a limit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy.props import IntProperty
from numpy.typing import NDArray

from ..blender import registration
from ..errors import AddonError
from ..jobs import confidence_job
from ..jobs.confidence_job import Known
from ..jobs.spec import JobSpec
from ..scene import heat_map, point_edits
from .base import FRESH, EngineOperator, available, failed, result_problem
from .clean_up import CleanUpTool

if TYPE_CHECKING:
    from ..blender import OperatorResult

FEW = 3
"""Directions: with fewer, depth and colour of a Gaussian are guessed."""


class FindConfidence(EngineOperator):
    """Measure how well the run's photos cover each Gaussian: number of photos, their directions, \
and the error of its colours in the test photos. Shows a heat map"""

    bl_idname = "roigs.find_confidence"
    bl_label = "Find Confidence"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a finished training, Gaussians, and an idle engine."""
        none = "" if point_edits.targets(context) else point_edits.NONE
        return available(cls, result_problem(context) or none)

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Ask, keep the answers with the points, and show them."""
        return confidence_job.spec(context, _take)


def _take(known: Known) -> str:
    for item, columns in known.items():
        heat_map.keep(item, columns)
    heat_map.show(known)
    every = np.concatenate([columns[:, heat_map.DIRECTIONS] for columns in known.values()])
    every = every[np.isfinite(every)]
    few = int((every < FEW).sum())
    return f"{few:,} of {len(every):,} Gaussians are seen from fewer than {FEW} directions"


class ShowHeatMap(bpy.types.Operator):
    """Show or hide the heat map: blue Gaussians are seen from few directions, yellow ones from \
many"""

    bl_idname = "roigs.show_heat_map"
    bl_label = "Heat Map"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Photos must have been asked."""
        shown = heat_map.most() is not None or heat_map.asked(point_edits.targets(context))
        return available(cls, "" if shown else "Click Find Confidence first")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Switch it."""
        if heat_map.most() is not None:
            heat_map.hide()
            return {"FINISHED"}
        try:
            heat_map.show(point_edits.checked_targets(context))
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}


class ChooseByDirections(CleanUpTool):
    """Select or delete Gaussians seen from few directions. Works on the selected Gaussian \
objects, otherwise on all visible ones"""

    bl_idname = "roigs.choose_by_directions"
    bl_label = "Seen From Few Directions"
    bl_options = {"REGISTER", "UNDO"}

    fewer: IntProperty(
        name="Fewer Than",
        description="Select Gaussians seen from fewer directions (about 18° apart)",
        default=FEW,
        min=1,
        max=128,
        options=FRESH,
    )

    def mask(self, item: bpy.types.Object, context: bpy.types.Context) -> NDArray[np.bool_]:
        """By what photos said."""
        return heat_map.few(item, self.fewer)


register, unregister = registration(FindConfidence, ShowHeatMap, ChooseByDirections)
