"""Step 5, Result: light, shadows and reflections between the scene and the user's objects."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.props import EnumProperty
from mathutils import Vector

from ..blender import registration, scene_of, view_layer_of
from ..engine.python import FOR_MASKS, FOR_SURFACES
from ..errors import AddonError
from ..jobs import run_folders, stage_job, undo
from ..jobs.spec import JobSpec
from ..properties import object_props
from ..scene import box_surfaces, lookup, stage
from ..windows import redraw
from .base import (
    FRESH,
    NO_BOX,
    EngineOperator,
    available,
    failed,
    own_problem,
    result_problem,
    tell,
)

if TYPE_CHECKING:
    from ..blender import OperatorResult

ACTIVE, CURSOR, BOX = "ACTIVE", "CURSOR", "BOX"
PLACES = (
    (ACTIVE, "Active Object", "From the middle of the active object"),
    (CURSOR, "3D Cursor", "From the 3D cursor"),
    (BOX, "Active Box", "From the middle of the active box"),
)


class LightFromScene(EngineOperator):
    """Light your own objects with the captured scene's light around a point. The camera still \
sees your own world"""

    bl_idname = "roigs.light_from_scene"
    bl_label = "Light From Scene"

    where: EnumProperty(name="From", items=PLACES, default=ACTIVE, options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a finished training, and an idle engine."""
        return available(cls, own_problem(context) or result_problem(context))

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Those that draw, and write the picture."""
        return FOR_MASKS

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Take the picture all around."""
        item = view_layer_of(context).objects.active
        radius = radius_of(item) if self.where == ACTIVE and item is not None else 0.0
        wanted = stage_job.Wanted(light=self._at(context), radius=radius)
        return stage_job.spec(scene_of(context), wanted)

    def _at(self, context: bpy.types.Context) -> Vector:
        if self.where == CURSOR:
            return scene_of(context).cursor.location.copy()
        if self.where == BOX:
            box = lookup.active_roi(context)
            if box is None:
                raise AddonError(f"{NO_BOX}.")
            return Vector(lookup.matrix_world(box)[:3, 3].tolist())
        item = view_layer_of(context).objects.active
        if item is None:
            raise AddonError("There is no active object. Select one, or choose the 3D cursor.")
        return middle(item)


class CatchShadows(EngineOperator):
    """Let the captured scene receive shadows and light of your own objects, and let these reflect \
it. The engine makes a mesh of the background once"""

    bl_idname = "roigs.catch_shadows"
    bl_label = "Catch Shadows"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a finished training, and an idle engine."""
        return available(cls, own_problem(context) or result_problem(context))

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Those that make meshes."""
        return FOR_SURFACES

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Make the mesh of the background."""
        return stage_job.spec(scene_of(context), stage_job.Wanted(shadows=True))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Without the engine, if its mesh is there."""
        if stage_job.is_needed(scene_of(context), stage_job.Wanted(shadows=True)):
            return EngineOperator.invoke(self, context, event)
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Run to the end."""
        scene, wanted = scene_of(context), stage_job.Wanted(shadows=True)
        if stage_job.is_needed(scene, wanted):
            return EngineOperator.execute(self, context)
        try:
            said = stage_job.apply(scene, run_folders.run_folder(scene), wanted, None)
        except AddonError as error:
            return failed(self, error)
        tell(self, "INFO", said)
        undo.push(self.bl_label)
        redraw()
        return {"FINISHED"}


class RemoveStage(bpy.types.Operator):
    """Undo light, shadows and reflections: restores world, film, passes and compositor"""

    bl_idname = "roigs.remove_stage"
    bl_label = "Remove"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be something to remove."""
        nothing = "" if stage.is_set(scene_of(context)) else "There is none"
        return available(cls, own_problem(context) or nothing)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Remove it."""
        stage.remove(scene_of(context))
        redraw()
        return {"FINISHED"}


def middle(item: bpy.types.Object) -> Vector:
    """The middle of an object's bounds, in the world."""
    if item.type == "EMPTY" or object_props(item).kind == "ROI":
        return Vector(lookup.matrix_world(item)[:3, 3].tolist())
    foot = box_surfaces.foot(item)
    foot.z = (foot.z + lookup.corners(item)[:, 2].max()) / 2
    return foot


def radius_of(item: bpy.types.Object) -> float:
    """Half of an object's largest side, in the world; 0 if it has no size."""
    return float(lookup.sides(item).max()) / 2


register, unregister = registration(LightFromScene, CatchShadows, RemoveStage)
