"""Step 5, Result: adapt the result to another renderer."""

from __future__ import annotations

import bpy
from bpy.props import EnumProperty

from ..blender import registration, scene_of
from ..jobs import adapt_job
from ..jobs.spec import JobSpec
from ..scene import compared
from ..shared import choices
from .base import FRESH, EngineOperator, available, model_problem


class AdaptResult(EngineOperator):
    """Adapt the result to another renderer, by a short training. The trained result is kept"""

    bl_idname = "roigs.adapt_result"
    bl_label = "Adapt"

    made_for: EnumProperty(name="Made for", items=choices.MADE_FOR_ITEMS, options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be photos, a result, and an idle engine."""
        there = compared.shown_result(scene_of(context))
        return available(cls, model_problem(context) or ("" if there else "Load results first"))

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Adapt it, and show what was made."""
        return adapt_job.spec(scene_of(context), self.made_for)


register, unregister = registration(AdaptResult)
