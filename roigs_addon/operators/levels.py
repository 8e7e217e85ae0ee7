"""Step 5, Result: levels of detail."""

from __future__ import annotations

import bpy

from ..blender import registration, scene_of
from ..jobs import levels_job
from ..jobs.spec import JobSpec
from .base import EngineOperator, available, result_problem


class MakeLevels(EngineOperator):
    """Make levels of detail of the last result: from far away, the 3D view and renders then draw \
fewer Gaussians"""

    bl_idname = "roigs.make_levels"
    bl_label = "Make Levels"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a finished training, and an idle engine."""
        return available(cls, result_problem(context))

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Make them in the scene's run folder."""
        return levels_job.spec(scene_of(context))


register, unregister = registration(MakeLevels)
