"""Step 5, Result: put the active mesh on the clicked surface."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
from bpy.props import FloatVectorProperty
from bpy_extras import view3d_utils
from mathutils import Vector

from ..blender import registration, scene_of, view_layer_of
from ..engine.python import FOR_MASKS, FOR_SURFACES
from ..errors import AddonError
from ..jobs import current, run_folders, stage_job, undo
from ..jobs.job import Job
from ..jobs.spec import JobSpec
from ..properties import object_props
from ..scene import lookup, proxies, stage_world, standing
from ..scene.surfaces import TYPES
from ..stage_properties import stage_props
from ..windows import redraw
from .base import BUSY, FRESH, EngineOperator, available, failed, own_problem, tell
from .picking import PickTool, place_in_view, shown_points
from .results import to_get_some

if TYPE_CHECKING:
    from ..blender import OperatorResult

FACTOR = 2 * proxies.REACH
"""Side of a plane that catches, in radii of what stands on it."""


def problem(context: bpy.types.Context) -> str:
    """Why nothing can stand anywhere now; empty if it can."""
    item = view_layer_of(context).objects.active
    if current.busy():
        return BUSY
    if not lookup.splats(scene_of(context)):
        return to_get_some(scene_of(context))
    if item is None or item.type not in TYPES or object_props(item).kind != "NONE":
        return "Select a mesh of your own first"
    return "" if context.mode == "OBJECT" else "Leave edit mode first"


class StandHere(PickTool, EngineOperator):
    """Put the active mesh on a captured surface: click there. It gets the scene's light, casts \
shadows, and reflects its surroundings"""

    bl_idname = "roigs.stand_here"
    bl_label = "Stand Here"

    wanted = 1
    prompt = "Click the place for the object"

    point: FloatVectorProperty(name="Point", subtype="XYZ", options=FRESH)
    eye: FloatVectorProperty(
        name="Eye", subtype="XYZ", options=FRESH, description="Viewpoint of the click"
    )

    _eye, _way = Vector(), Vector()
    _job: Job | None = None  # type: ignore[assignment]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be Gaussians, a mesh of the user's, and an idle engine."""
        return available(cls, own_problem(context) or problem(context))

    def take(self, points: list[Vector]) -> None:
        """The place, and from where it was seen.

        A click finds a Gaussian near the mouse. The place is that deep, but right at the mouse.
        """
        self.point, self.eye = points[0], self._eye
        if self._way.length_squared:
            self.point = self._eye + (points[0] - self._eye).dot(self._way) * self._way

    def taken(self) -> bool:
        """Whether they are given."""
        return self.properties.is_property_set("point")

    def packages(self, context: bpy.types.Context) -> tuple[str, ...]:
        """Those that make meshes and pictures."""
        return tuple(dict.fromkeys((*FOR_SURFACES, *FOR_MASKS)))

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """First the click, then the engine's work."""
        if self._job is not None:
            return EngineOperator.modal(self, context, event)
        place = place_in_view(context, event)
        if place is not None:
            (region, view), at = place
            self._eye = view3d_utils.region_2d_to_origin_3d(region, view, at)
            self._way = view3d_utils.region_2d_to_vector_3d(region, view, at)
        return PickTool.modal(self, context, event)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Put it there at once; light and shadows come when the engine has made them."""
        try:
            self._put(context)
            scene, wanted = scene_of(context), self._wanted(context)
            stage_job.apply(scene, run_folders.run_folder(scene), wanted, None)
        except AddonError as error:
            return failed(self, error)
        redraw()
        if bpy.app.background:
            return EngineOperator.execute(self, context)
        try:
            self._job = self.start(context)
        except AddonError as error:
            undo.push(self.bl_label)
            tell(self, "WARNING", f"Without the scene's light: {error}")
            return {"FINISHED"}
        self._job.hears_esc = True
        return {"RUNNING_MODAL"}

    def spec(self, context: bpy.types.Context) -> JobSpec:
        """Make what is missing, and the picture of the light."""
        return stage_job.spec(scene_of(context), self._wanted(context))

    def _wanted(self, context: bpy.types.Context) -> stage_job.Wanted:
        item: Any = view_layer_of(context).objects.active
        uid, placed = item.session_uid, lookup.matrix_world(item)
        point, eye = Vector(self.point), Vector(self.eye)

        def catch(scene: bpy.types.Scene) -> None:
            """Put it on the mesh that was made, unless the user has moved or deleted it."""
            now = next((each for each in scene.objects if each.session_uid == uid), None)
            if now is not None and np.allclose(lookup.matrix_world(now), placed):
                with _shown(scene):
                    put(bpy.context, now, eye, point)

        return stage_job.Wanted(light=self._middle, radius=self._radius, shadows=True, then=catch)

    def _put(self, context: bpy.types.Context) -> None:
        item: Any = view_layer_of(context).objects.active
        self._radius = standing.radius_of(item, context.evaluated_depsgraph_get())
        self._middle = put(context, item, Vector(self.eye), Vector(self.point))


def _shown(scene: bpy.types.Scene) -> AbstractContextManager[object]:
    """Context in which a scene is the present one; the user may have switched to another."""
    if bpy.context.scene == scene:
        return nullcontext()
    return bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0])


def put(context: bpy.types.Context, item: bpy.types.Object, eye: Vector, point: Vector) -> Vector:
    """Put an object on the surface at a point, and have that catch its shadow.

    Returns:
        The object's middle.

    Raises:
        AddonError: there is no surface.
    """
    scene, depsgraph = scene_of(context), context.evaluated_depsgraph_get()
    radius = standing.radius_of(item, depsgraph)
    clouds = [points for _, points in shown_points(context)]
    spot = standing.find(scene, eye, point, radius, clouds)
    middle = standing.put(item, spot, depsgraph)
    if spot.on_mesh:
        proxies.drop_planes(scene, spot.point, spot.normal, FACTOR * radius)
    elif radius > 0:
        proxies.plane(scene, spot.point, spot.normal, FACTOR * radius)
        if (image := stage_world.picture(scene)) is not None:
            proxies.use_light(scene, image)
    proxies.set_reach(scene, radius or stage_props(scene).radius)
    view_layer_of(context).update()
    return middle


register, unregister = registration(StandHere)
