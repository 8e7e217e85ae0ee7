"""Points from the user: selected in edit mode, or clicked in the 3D view."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy_extras import view3d_utils
from mathutils import Vector
from numpy.typing import NDArray

from ..blender import scene_of, view_3d_of, view_layer_of
from ..geometry.picking import Sight, under
from ..scene import clouds, instances, lookup, rois
from ..scene.splat_attributes import values
from ..viewport import picks
from ..windows import redraw

if TYPE_CHECKING:
    from ..blender import OperatorResult

Points = NDArray[np.float32]

SOLID = 0.2
"""Opacity of Gaussians that a click may mean; of few photos, surfaces are layers of such."""

UNDO_KEYS = {"BACK_SPACE", "DEL"}


def selected(context: bpy.types.Context) -> NDArray[np.float64]:
    """(N, 3) in the world, of the vertices that are selected in edit mode, such as sparse points.

    Edit mode ends: an undo step of edit mode holds no objects.
    """
    item = context.active_object
    if context.mode != "EDIT_MESH" or item is None:
        return np.empty((0, 3))
    item.update_from_editmode()
    points = rois.selected_vertices(item)
    bpy.ops.object.mode_set(mode="OBJECT")
    return np.asarray(points, np.float64)


class PickTool(bpy.types.Operator):
    """Base of the operators on points that are clicked in the 3D view."""

    wanted = 2
    """How many points are clicked."""

    prompt = ""
    """What to click, for the status bar."""

    _points: list[Vector]
    _clouds: list[Points]

    def take(self, points: list[Vector]) -> None:
        """Keep the points in properties, so that the operator can be repeated."""
        raise NotImplementedError

    def taken(self) -> bool:
        """Whether the properties have points."""
        raise NotImplementedError

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Take the vertices selected in edit mode, else let the user click."""
        editing = context.mode == "EDIT_MESH" and selection_is_there(context)
        if bpy.app.background or editing or self.taken() or view_3d_of(context) is None:
            return self.execute(context)
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        self._points, self._clouds = [], [points for _, points in shown_points(context)]
        assert context.window_manager is not None
        context.window_manager.modal_handler_add(self)
        self._show(context, None)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Collect clicks; everything else, such as turning the view, goes to the window."""
        if event.type in {"ESC", "RIGHTMOUSE"} and event.value == "PRESS":
            self._end(context)
            return {"CANCELLED"}
        if event.type in UNDO_KEYS and event.value == "PRESS" and self._points:
            self._points.pop()
            self._show(context, None)
            return {"RUNNING_MODAL"}
        if event.type not in {"MOUSEMOVE", "LEFTMOUSE"}:
            return {"PASS_THROUGH"}
        place = place_in_view(context, event)
        if place is None:
            return {"PASS_THROUGH"}
        found = in_front(context, *place, self._clouds)
        point = None if found is None else found[0]
        if event.type == "LEFTMOUSE" and event.value == "PRESS":
            if point is not None:
                self._points.append(point)
            if len(self._points) == self.wanted:
                self._end(context)
                self.take(self._points)
                return self.execute(context)
        self._show(context, point)
        return {"PASS_THROUGH"} if event.type == "MOUSEMOVE" else {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator, as when another file is opened."""
        self._end(context)

    def _show(self, context: bpy.types.Context, point: Vector | None) -> None:
        picks.show(list(self._points), point)
        said = f"{self.prompt} ({len(self._points) + 1} of {self.wanted})"
        keys = "Backspace: remove the last one. Esc: cancel"
        if context.workspace is not None:
            context.workspace.status_text_set(f"{said}. {keys}")
        redraw()

    def _end(self, context: bpy.types.Context) -> None:
        picks.hide()
        self._clouds = []
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        redraw()


def selection_is_there(context: bpy.types.Context) -> bool:
    """Whether a vertex is selected in edit mode."""
    item = context.active_object
    if item is None or not isinstance(item.data, bpy.types.Mesh):
        return False
    item.update_from_editmode()
    return bool(item.data.total_vert_sel)


def shown_points(context: bpy.types.Context) -> list[tuple[bpy.types.Object, Points]]:
    """(N, 3) in the world, of the sparse points and of each object of Gaussians that is seen.

    With the object that a click there means: for an instance, what instances it.
    """
    scene, space = scene_of(context), view_3d_of(context)
    own = filter(None, (lookup.points(scene), *lookup.splats(scene)))
    places = [(i, i, lookup.matrix_world(i)) for i in own if i.visible_get(viewport=space)]
    for each in instances.in_view(view_layer_of(context)):
        if each.instancer.visible_get(viewport=space):
            places.append((each.instancer, each.item, each.matrix))
    found = []
    for meant, item, matrix in places:
        mesh = item.data
        if not isinstance(mesh, bpy.types.Mesh):
            continue
        points, opacities = clouds.positions(item), values(mesh, "opacity")
        if opacities is not None:
            points = points[opacities[:, 0] >= SOLID]
        world = matrix.astype(np.float32)
        found.append((meant, points @ world[:3, :3].T + world[:3, 3]))
    return found


View = tuple[bpy.types.Region, bpy.types.RegionView3D]
Place = tuple[View, tuple[float, float]]
"""The region of a 3D view, and where in it, in pixels."""


def place_in_view(context: bpy.types.Context, event: bpy.types.Event) -> Place | None:
    """The region of the 3D view that the mouse is in, and where in it; None if it is elsewhere."""
    area, space = context.area, view_3d_of(context)
    if area is None or space is None:
        return None
    others = [region for region in area.regions if region.type != "WINDOW" and region.width > 1]
    if any(_inside(region, event) for region in others):
        return None
    regions = [region for region in area.regions if region.type == "WINDOW"]
    for number, region in enumerate(regions):
        quads = space.region_quadviews
        view = quads[number] if len(quads) == len(regions) else space.region_3d
        if view is not None and _inside(region, event):
            return (region, view), (event.mouse_x - region.x, event.mouse_y - region.y)
    return None


def _inside(region: bpy.types.Region, event: bpy.types.Event) -> bool:
    x, y = event.mouse_x - region.x, event.mouse_y - region.y
    return bool(0 <= x < region.width and 0 <= y < region.height)


def in_front(
    context: bpy.types.Context, view: View, at: tuple[float, float], found: list[Points]
) -> tuple[Vector, int] | None:
    """The sparse point, the Gaussian or the place on a mesh that is in front at the mouse.

    With the number of its points in `found`; -1 for a mesh.
    """
    region, data = view
    size = region.width, region.height
    sight = Sight(np.array(data.view_matrix), np.array(data.window_matrix), size)
    rows = [(number, under(points, sight, at)) for number, points in enumerate(found)]
    hits = [(found[number][row], number) for number, row in rows if row is not None]
    eye = view3d_utils.region_2d_to_origin_3d(region, data, at)
    ray = view3d_utils.region_2d_to_vector_3d(region, data, at)
    hit, place, *_ = scene_of(context).ray_cast(context.evaluated_depsgraph_get(), eye, ray)
    if hit:
        hits.append((np.array(place, np.float32), -1))
    if not hits:
        return None
    nearest = int(np.argmin(sight.depths(np.array([point for point, _ in hits]))))
    point, number = hits[nearest]
    return Vector(point.tolist()), number
