"""Clicks on Gaussians in the 3D view: select them, and put the 3D cursor on them.

Blender's own clicks miss Gaussians that the add-on draws. Blender's click runs first; its result
stays unless it is behind Gaussians.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy
from bpy.props import BoolProperty
from bpy_extras import view3d_utils
from mathutils import Matrix, Vector

from ..blender import scene_of, view_3d_of, view_layer_of
from ..properties import object_props
from ..scene import instances, lookup
from ..viewport.objects import SURFACES
from .base import FRESH
from .picking import Place, in_front, place_in_view, shown_points

if TYPE_CHECKING:
    from ..blender import OperatorResult

TWEAK = "builtin.select"
"""Blender's tool that selects when the button goes down, so before this operator."""


class ClickGaussians(bpy.types.Operator):
    """Select the object under the mouse, including Gaussians"""

    bl_idname = "roigs.click"
    bl_label = "Select with Gaussians"
    bl_options = {"UNDO"}

    toggle: BoolProperty(description="Add to the selection, or remove from it", options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """In object mode, where Gaussians are drawn, and where the left button selects."""
        return context.mode == "OBJECT" and _has_gaussians(context) and _left_selects(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Let Blender select; then look what is in front."""
        place, objects = place_in_view(context, event), view_layer_of(context).objects
        tool = context.workspace and context.workspace.tools.from_space_view3d_mode("OBJECT")
        if place is None or (self.toggle and tool and tool.idname == TWEAK):
            return {"PASS_THROUGH"}
        before, active = set(objects.selected), objects.active
        at = tuple(map(int, place[1]))
        bpy.ops.view3d.select(location=at, toggle=self.toggle, deselect_all=not self.toggle)
        after = set(objects.selected)
        hit = before ^ after if self.toggle else set(after)
        if objects.active is not None and objects.active != active:
            hit.add(objects.active)
        shown = [(item, points) for item, points in shown_points(context) if not item.hide_select]
        found = in_front(context, *place, [points for _, points in shown])
        if found is None or found[1] < 0:
            return {"FINISHED"}
        point, item = found[0], shown[found[1]][0]
        eye = place[0][1].view_matrix
        if object_props(item).kind == "POINTS" or any(_stays(other, point, eye) for other in hit):
            return {"FINISHED"}  # Blender selects sparse points itself
        for other in before | after:
            other.select_set(self.toggle and other in before)
        item.select_set(not (self.toggle and item in before and item == active))
        objects.active = item
        return {"FINISHED"}


class PlaceCursor(bpy.types.Operator):
    """Set the 3D cursor on the surface under the mouse, including Gaussians"""

    bl_idname = "roigs.place_cursor"
    bl_label = "Set 3D Cursor on Gaussians"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether Gaussians are drawn, and this key is Blender's for the cursor."""
        return _has_gaussians(context) and _left_selects(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Let Blender place it; then move it to Gaussians that are in front."""
        place = place_in_view(context, event)
        if place is None:
            return {"PASS_THROUGH"}
        bpy.ops.view3d.cursor3d("INVOKE_DEFAULT")
        point = surface(context, place)
        if point is not None:
            scene_of(context).cursor.location = point
        return {"FINISHED"}


def surface(context: bpy.types.Context, place: Place) -> Vector | None:
    """The Gaussians' place in the world at the mouse; None if they are not in front there."""
    (region, view), at = place
    found = in_front(context, (region, view), at, [points for _, points in shown_points(context)])
    if found is None or found[1] < 0:
        return None
    return view3d_utils.region_2d_to_location_3d(region, view, at, found[0])


def _has_gaussians(context: bpy.types.Context) -> bool:
    """Whether it is a 3D view of a scene in which Gaussians may be drawn."""
    if view_3d_of(context) is None:
        return False
    items = lookup.splats(scene_of(context))
    return any(map(instances.is_drawn, items)) or bool(instances.in_view(view_layer_of(context)))


def _stays(item: bpy.types.Object, point: Vector, eye: Matrix) -> bool:
    """Whether something that Blender has found is in front of a Gaussian, or is a box."""
    if object_props(item).kind == "ROI":
        return True
    nearer: bool = (eye @ item.matrix_world.translation).z > (eye @ point).z
    return item.type not in SURFACES and nearer


def _left_selects(context: bpy.types.Context) -> bool:
    """Whether the user's keymap selects with the left button."""
    manager = context.window_manager
    active: Any = manager.keyconfigs.active if manager is not None else None
    preferences = active.preferences if active is not None else None
    return getattr(preferences, "select_mouse", "LEFT") == "LEFT"


KEYS = (
    ("Object Mode", "EMPTY", ClickGaussians.bl_idname, "LEFTMOUSE", "CLICK", False),
    ("Object Mode", "EMPTY", ClickGaussians.bl_idname, "LEFTMOUSE", "CLICK", True),
    ("3D View", "VIEW_3D", PlaceCursor.bl_idname, "RIGHTMOUSE", "PRESS", True),
    ("3D View Tool: Cursor", "VIEW_3D", PlaceCursor.bl_idname, "LEFTMOUSE", "PRESS", False),
)
"""Keymap, its space, operator, button, event, and whether Shift is held."""

_keys: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []


def register() -> None:
    """Register the operators, and bind them; in background mode there are no keys."""
    bpy.utils.register_class(ClickGaussians)
    bpy.utils.register_class(PlaceCursor)
    manager = bpy.context.window_manager
    config: Any = manager.keyconfigs.addon if manager is not None else None
    if config is None or bpy.app.background:
        return
    for name, space, operator, button, value, shift in KEYS:
        keymap = config.keymaps.new(name, space_type=space)
        key = keymap.keymap_items.new(operator, button, value, shift=shift)
        if operator == ClickGaussians.bl_idname:
            key.properties.toggle = shift
        _keys.append((keymap, key))


def unregister() -> None:
    """Undo `register`."""
    for keymap, key in _keys:
        keymap.keymap_items.remove(key)
    _keys.clear()
    bpy.utils.unregister_class(PlaceCursor)
    bpy.utils.unregister_class(ClickGaussians)
