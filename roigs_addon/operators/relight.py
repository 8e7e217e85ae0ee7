"""Step 5, Result: relight a captured object, and use it in other files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.props import StringProperty

from ..blender import registration, scene_of
from ..engine.python import FOR_TRAINING
from ..errors import AddonError
from ..jobs import relight_job
from ..jobs.spec import JobSpec
from ..scene import relight, taken
from ..windows import redraw
from .base import FRESH, EngineOperator, available, failed, result_problem, tell
from .surface import NO_MESH, mesh_named

if TYPE_CHECKING:
    from ..blender import OperatorResult


class Relight(EngineOperator):
    """Light this object's mesh with your lamps and world: divides its texture by the light of the \
capture. The slider Relit goes from as captured to relit. Highlights and hard shadows of the \
photos stay in the texture"""

    bl_idname = "roigs.relight"
    bl_label = "Relight"

    name: StringProperty(description="Name of the mesh's object", options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a finished training, and an idle engine."""
        return available(cls, result_problem(context))

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Those that draw."""
        return FOR_TRAINING

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Draw the captured light."""
        item = mesh_named(context, self.name)
        if item is None:
            raise AddonError(NO_MESH.format(self.name))
        return relight_job.spec(scene_of(context), item)


class StopRelight(bpy.types.Operator):
    """Restore the mesh's own material"""

    bl_idname = "roigs.stop_relight"
    bl_label = "Stop Relighting"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(description="Name of the mesh's object", options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Remove material and slider."""
        item = mesh_named(context, self.name)
        if item is None:
            return failed(self, NO_MESH.format(self.name))
        relight.remove(item)
        redraw()
        return {"FINISHED"}


class TakeObject(bpy.types.Operator):
    """Make an asset of this object, for other scenes: its mesh and its Gaussians, with the origin \
at its foot. Save the file, then find it in the Asset Browser"""

    bl_idname = "roigs.take_object"
    bl_label = "Take Object"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(description="Name of the mesh's object", options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Copy them into a collection, and mark that as an asset."""
        item = mesh_named(context, self.name)
        if item is None:
            return failed(self, NO_MESH.format(self.name))
        try:
            asset = taken.take(scene_of(context), item)
        except AddonError as error:
            return failed(self, error)
        tell(self, "INFO", f"'{asset.name}' is an asset of this file. Save the file to use it")
        redraw()
        return {"FINISHED"}


register, unregister = registration(Relight, StopRelight, TakeObject)
