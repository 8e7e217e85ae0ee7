"""Step 3, Cameras: strokes on a photo, on a box's object and around it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..blender import registration, scene_of, view_3d_of
from ..geometry.photo_places import Place, on_photo, start, thinned, unit
from ..properties import object_props, scene_props
from ..scene import cameras, lookup, masks, scribbles
from ..viewport import photo_overlay
from ..windows import redraw
from .base import FRESH, NO_BOX, available, box_problem, failed
from .picking import place_in_view

if TYPE_CHECKING:
    from ..blender import OperatorResult

KINDS = (
    (scribbles.OBJECT, "Object", "Strokes are on the object"),
    (scribbles.BACKGROUND, "Background", "Strokes are on the background"),
)
END = {"ESC", "RET", "NUMPAD_ENTER"}
MOVES = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"}
"""The latter are what Blender has left out while it was busy drawing."""

LEAST = 2.0
"""Pixels of the window between two points of a stroke."""
STATUS = (
    "Drag: {kind}. Ctrl drag: {other}. Tab: swap them. [ ]: width. Ctrl Z: undo. Enter or Esc: end"
)
NO_PHOTO = "Look through a photo's camera first."


class Scribble(bpy.types.Operator):
    """Draw on the photo: a few lines on the object, and one around it with Ctrl. Each stroke is \
one undo step"""

    bl_idname = "roigs.scribble"
    bl_label = "Scribble"

    kind: EnumProperty(name="Strokes", items=KINDS, default=scribbles.OBJECT, options=FRESH)
    width: IntProperty(
        name="Width",
        default=6,
        min=1,
        max=200,
        subtype="PIXEL",
        description="In the window",
        options=FRESH,
    )

    _points: list[Place]
    _hover: Place | None
    _drawn: str

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box, photos, and a 3D view to draw in."""
        view = "" if view_3d_of(context) else "Use it in a 3D view"
        return available(cls, box_problem(context) or view)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Look through a photo, and wait for strokes."""
        view, scene = view_3d_of(context), scene_of(context)
        roi = lookup.active_roi(context)
        camera = _camera(context, roi)
        if roi is None or view is None or view.region_3d is None or camera is None:
            return failed(self, f"{NO_BOX}." if roi is None else NO_PHOTO)
        cameras.activate(scene, camera)
        view.region_3d.view_perspective = "CAMERA"
        scene_props(scene).show_masks = True
        self._points, self._hover = [], None
        assert context.window_manager is not None
        context.window_manager.modal_handler_add(self)
        self._say(context)
        redraw()
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Follow the mouse; other events, such as zooming the view, go to the window."""
        if self._points:
            return self._draw_on(context, event)
        if event.type in END and event.value == "PRESS":
            self._end(context)
            return {"FINISHED"}
        place = self._place(context, event)
        if event.type in MOVES:
            self._hover = None if place is None else place[0]
        if place is None or event.value != "PRESS":
            return {"PASS_THROUGH"}
        if event.type == "TAB":
            self.kind = self._other()
            self._say(context)
        elif event.type in {"LEFT_BRACKET", "RIGHT_BRACKET"}:
            change = 1 if event.type == "RIGHT_BRACKET" else -1
            self.width = max(1, self.width + change)
        elif event.type == "LEFTMOUSE" and not event.alt:
            self._drawn = self._other() if event.ctrl else self.kind
            self._points = [place[0]]
            self._show(place[1])
        else:
            return {"PASS_THROUGH"}
        return {"RUNNING_MODAL"}

    def _draw_on(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Follow a stroke to its end; Esc and the right button drop it."""
        place = self._place(context, event)
        if event.type in {"ESC", "RIGHTMOUSE"} and event.value == "PRESS":
            self._points = []
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            if place is not None:
                self._points.append(place[0])
            self._keep(context, place[1] if place else 1.0)
        elif event.type in MOVES and place is not None:
            if len(self._points) == 1:
                self._points[0] = start(self._points[0], self._hover, place[0])
            self._points.append(place[0])
            self._show(place[1])
        if not self._points:
            photo_overlay.hide_stroke()
        redraw()
        return {"RUNNING_MODAL"}

    def _keep(self, context: bpy.types.Context, pixel: float) -> None:
        """Give the stroke to the box."""
        roi, photo = lookup.active_roi(context), masks.photo_at_hand(context)
        points, self._points = thinned(self._points, LEAST * pixel), []
        if roi is not None and photo is not None:
            scribbles.add_stroke(roi, photo.name, self._drawn, self.width * pixel, points)
            bpy.ops.ed.undo_push(message="Stroke")

    def _place(
        self, context: bpy.types.Context, event: bpy.types.Event
    ) -> tuple[tuple[float, float], float] | None:
        """Place of the mouse on the photo, and the photo's pixels in one of the window."""
        found, photo = place_in_view(context, event), masks.photo_at_hand(context)
        if found is None or photo is None:
            return None
        (region, view), at = found
        if view.view_perspective != "CAMERA":
            return None
        with context.temp_override(area=context.area, region=region):
            frame = photo_overlay.frame_of(bpy.context)
        if frame is None:
            return None
        size = masks.size_of(photo)
        return on_photo(at, frame, size), unit(frame, size)

    def _show(self, pixel: float) -> None:
        photo_overlay.show_stroke(self._drawn, self._points, self.width * pixel)
        redraw()

    def _other(self) -> str:
        return scribbles.BACKGROUND if self.kind == scribbles.OBJECT else scribbles.OBJECT

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator, as when another file is opened."""
        self._end(context)

    def _say(self, context: bpy.types.Context) -> None:
        if context.workspace is not None:
            text = STATUS.format(kind=self.kind, other=self._other())
            context.workspace.status_text_set(text)

    def _end(self, context: bpy.types.Context) -> None:
        photo_overlay.hide_stroke()
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        redraw()


class ClearStrokes(bpy.types.Operator):
    """Remove the active box's strokes on the current photo"""

    bl_idname = "roigs.clear_strokes"
    bl_label = "Clear Strokes"
    bl_options = {"REGISTER", "UNDO"}

    photo: StringProperty(
        description="Name of the photo; empty: the one in the view", options=FRESH
    )
    every: BoolProperty(name="All", description="On all photos", options=FRESH)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box."""
        return available(cls, box_problem(context))

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Remove them."""
        roi, photo = lookup.active_roi(context), masks.photo_at_hand(context)
        if roi is None:
            return failed(self, f"{NO_BOX}.")
        name = self.photo or (photo.name if photo else "")
        if not name and not self.every:
            return failed(self, NO_PHOTO)
        for each in scribbles.photos(roi) if self.every else [name]:
            scribbles.clear(roi, each)
        redraw()
        return {"FINISHED"}


def _camera(context: bpy.types.Context, roi: bpy.types.Object | None) -> bpy.types.Object | None:
    """The camera that is looked through, else the one of the box's first photo."""
    scene = scene_of(context)
    view, camera = view_3d_of(context), scene.camera
    region = view.region_3d if view is not None else None
    through = region is not None and region.view_perspective == "CAMERA"
    if through and camera is not None and lookup.is_photo_camera(camera):
        return camera
    every = lookup.cameras(scene)
    chosen = [item.name for item in object_props(roi).selection] if roi is not None else []
    best = next((every[name] for name in chosen if name in every), None)
    return best or lookup.camera_at_hand(context) or next(iter(every.values()), None)


register, unregister = registration(Scribble, ClearStrokes)
