"""Step 5, Result: find floaters."""

from __future__ import annotations

import bpy
from bpy.props import EnumProperty

from ..blender import registration
from ..jobs import floaters_job
from ..jobs.spec import JobSpec
from ..scene import point_edits
from .base import FRESH, EngineOperator, available, model_problem
from .clean_up import ACTIONS, act


class FindFloaters(EngineOperator):
    """Find floaters in front of the boxes or among the cameras, by the rule that training uses"""

    bl_idname = "roigs.find_floaters"
    bl_label = "Floaters"

    action: EnumProperty(name="Action", items=ACTIONS, options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be photos to judge by, Gaussians, and an idle engine."""
        none = "" if point_edits.targets(context) else point_edits.NONE
        return available(cls, model_problem(context) or none)

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Find them, then select or delete them."""
        action = self.action
        return floaters_job.spec(context, lambda found: act(found, action, what="floater"))


register, unregister = registration(FindFloaters)
