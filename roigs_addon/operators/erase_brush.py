"""Step 5, Result: a brush that erases Gaussians in the 3D view.

Blender's own circle select selects all points below the circle, including hidden ones behind
surfaces. This brush can be limited to visible points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, IntProperty
from numpy.typing import NDArray

from ..blender import leave_edit_mode, registration, scene_of, view_3d_of
from ..errors import AddonError
from ..geometry.brush import below, in_front
from ..geometry.picking import Sight
from ..scene import lookup, point_edits
from ..viewport import brush
from ..windows import redraw
from .base import FRESH, available, failed, tell
from .clean_up import ACTIONS, act
from .picking import Place, place_in_view

if TYPE_CHECKING:
    from ..blender import OperatorResult

LARGER, SMALLER = {"WHEELUPMOUSE", "RIGHT_BRACKET"}, {"WHEELDOWNMOUSE", "LEFT_BRACKET"}
STEP = 1.15  # factor of one turn of the wheel
END = {"ESC", "RIGHTMOUSE", "RET", "NUMPAD_ENTER"}
STATUS = "Drag to {verb}. Wheel or [ ]: radius. F: only in front ({front}). Ctrl Z: undo. Esc: end"

_last: dict[str, float] = {}
"""Radius and front of the last brush of this session."""

Circles = list[tuple[float, float]]
Mask = NDArray[np.bool_]


class Stroke:
    """One stroke: which points of which objects lie below it. Holds no data of Blender's."""

    def __init__(self, context: bpy.types.Context, sight: Sight, *, front: bool) -> None:
        """Look at what is in the view; raises AddonError if there is nothing to erase."""
        self.names = [item.name for item in point_edits.checked_targets(context)]
        self._found: dict[str, tuple[NDArray[np.float64], Mask, Mask]] = {}
        items = point_edits.visible(context)
        points = [point_edits.places(item) for item in items]
        masks = _fronts(items, points, sight) if front else [np.ones(len(p), bool) for p in points]
        for item, placed, mask in zip(items, points, masks, strict=True):
            if item.name in self.names:
                pixels, between = sight.pixels(placed)
                self._found[item.name] = pixels, between & mask, np.zeros(len(placed), bool)

    def add(self, circles: Circles, radius: float) -> None:
        """Take what lies below circles, too."""
        for pixels, seen, taken in self._found.values():
            taken |= below(pixels, seen, circles, radius)

    def places(self) -> NDArray[np.float64]:
        """(N, 2) of what has been taken, in pixels."""
        return np.concatenate([pixels[taken] for pixels, _, taken in self._found.values()])

    def apply(self, context: bpy.types.Context, action: str) -> str:
        """Erase or select it; returns a line that says how many."""
        objects = scene_of(context).objects
        masks = {name: taken for name, (_, _, taken) in self._found.items() if name in objects}
        items = {objects[name]: mask for name, mask in masks.items()}
        return act(items, action, extend=True)


def _fronts(
    items: Sequence[bpy.types.Object], points: list[NDArray[np.float64]], sight: Sight
) -> list[Mask]:
    """Points of each object that no nearer Gaussians hide, of any object."""
    sizes = np.concatenate([point_edits.scales(item).mean(axis=1) for item in items])
    opacity = np.concatenate([point_edits.opacities(item) for item in items])
    shown = in_front(np.concatenate(points), sizes, opacity, sight)
    return np.split(shown, np.cumsum([len(placed) for placed in points])[:-1])


class EraseBrush(bpy.types.Operator):
    """Erase Gaussians with a brush. Works on the selected Gaussian objects, otherwise on all \
visible ones. Each stroke is one undo step"""

    bl_idname = "roigs.erase_brush"
    bl_label = "Erase Brush"

    action: EnumProperty(name="Action", items=ACTIONS, default="DELETE", options=FRESH)
    radius: IntProperty(name="Radius", default=40, min=2, max=1000, subtype="PIXEL", options=FRESH)
    front: BoolProperty(
        name="Only in Front",
        description="Keep Gaussians hidden by nearer ones",
        default=True,
        options=FRESH,
    )

    _stroke: Stroke | None
    _last: tuple[float, float]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be Gaussians, and a 3D view to draw in."""
        none = "" if point_edits.targets(context) else point_edits.NONE
        return available(cls, none or ("" if view_3d_of(context) else "Use it in a 3D view"))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Wait for strokes."""
        leave_edit_mode(lookup.splats(scene_of(context)))
        assert context.window_manager is not None
        self._stroke = None
        for name, value in _last.items():
            if not self.properties.is_property_set(name):
                setattr(self, name, value)
        context.window_manager.modal_handler_add(self)
        self._say(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Follow the mouse; other events, such as turning the view, go to the window."""
        place = place_in_view(context, event)
        if self._stroke is not None:
            return self._draw_on(context, event, place)
        if event.type in END and event.value == "PRESS":
            self._end(context)
            return {"FINISHED"}
        if place is None:
            return {"PASS_THROUGH"}
        (region, view), at = place
        if event.value == "PRESS" and event.type in LARGER | SMALLER and not event.ctrl:
            self.radius = round(self.radius * (STEP if event.type in LARGER else 1 / STEP))
        elif event.value == "PRESS" and event.type == "F":
            self.front = not self.front
            self._say(context)
        elif event.value == "PRESS" and event.type == "LEFTMOUSE" and not event.alt:
            size = region.width, region.height
            sight = Sight(np.array(view.view_matrix), np.array(view.window_matrix), size)
            try:
                self._stroke = Stroke(context, sight, front=self.front)
            except AddonError as error:
                self._end(context)
                return failed(self, error)
            self._last = at
            self._take(at)
        elif event.type != "MOUSEMOVE":
            return {"PASS_THROUGH"}
        brush.show(region, at, self.radius)
        redraw()
        return {"PASS_THROUGH"} if event.type == "MOUSEMOVE" else {"RUNNING_MODAL"}

    def _draw_on(
        self, context: bpy.types.Context, event: bpy.types.Event, place: Place | None
    ) -> OperatorResult:
        """Follow a stroke to its end; Esc and the right button drop it."""
        assert self._stroke is not None
        if event.type in {"ESC", "RIGHTMOUSE"} and event.value == "PRESS":
            self._stroke = None
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            stroke, self._stroke = self._stroke, None
            try:
                said = stroke.apply(context, self.action)
            except AddonError as error:
                self._end(context)
                return failed(self, error)
            bpy.ops.ed.undo_push(message=self.bl_label)
            tell(self, "INFO", said)
        elif event.type == "MOUSEMOVE" and place is not None:
            (region, _), at = place
            self._take(at)
            brush.show(region, at, self.radius)
        if self._stroke is None:
            brush.mark(np.empty((0, 2)))
        redraw()
        return {"RUNNING_MODAL"}

    def _take(self, at: tuple[float, float]) -> None:
        """Take what lies below the way of the mouse."""
        assert self._stroke is not None
        way = np.subtract(at, self._last)
        steps = 1 + int(np.hypot(*way) / (self.radius / 2))
        ways = [way * (step / steps) for step in range(1, steps + 1)]
        begin = self._last
        circles = [(float(begin[0] + x), float(begin[1] + y)) for x, y in ways]
        self._stroke.add([*circles, begin], self.radius)
        self._last = at
        brush.mark(self._stroke.places())

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator, as when another file is opened."""
        self._end(context)

    def _say(self, context: bpy.types.Context) -> None:
        if context.workspace is not None:
            verb = "erase" if self.action == "DELETE" else "select"
            front = "on" if self.front else "off"
            context.workspace.status_text_set(STATUS.format(verb=verb, front=front))

    def _end(self, context: bpy.types.Context) -> None:
        _last.update(radius=self.radius, front=self.front)
        brush.hide()
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        redraw()


register, unregister = registration(EraseBrush)
