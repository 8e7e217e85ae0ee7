"""Drags the line between a photo and the Gaussians in a view through its camera."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy

from ..blender import interface_scale, registration, scene_of
from ..properties import scene_props
from ..viewport import photo_wipe
from ..windows import redraw

if TYPE_CHECKING:
    from ..blender import OperatorResult

REACH = 8.0
"""Distance in pixels within which the line can be dragged, at an interface scale of 1."""


class WipeHandle(bpy.types.Gizmo):
    """Drags the line."""

    bl_idname = "ROIGS_GT_wipe"

    _before: float

    def draw(self, context: bpy.types.Context) -> None:
        """Draw nothing: the line already has arrows."""

    def test_select(self, context: bpy.types.Context, location: Any) -> int:
        """Return 0 if the mouse, in pixels of the region, is near the line, else -1."""
        frame = photo_wipe.frame_of(context)
        if frame is None or not frame[1] <= location[1] <= frame[3]:
            return -1
        away = abs(location[0] - photo_wipe.line_of(context, frame))
        return 0 if away <= REACH * interface_scale() else -1

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Begin to drag."""
        self._before = scene_props(scene_of(context)).wipe
        return {"RUNNING_MODAL"}

    def modal(
        self, context: bpy.types.Context, event: bpy.types.Event, tweak: object
    ) -> OperatorResult:
        """Follow the mouse."""
        frame = photo_wipe.frame_of(context)
        if frame is not None:
            share = (event.mouse_region_x - frame[0]) / max(frame[2] - frame[0], 1.0)
            scene_props(scene_of(context)).wipe = share
            redraw()
        return {"RUNNING_MODAL"}

    def exit(self, context: bpy.types.Context, cancel: bool | None) -> None:
        """Put the line back after Esc."""
        if cancel:
            scene_props(scene_of(context)).wipe = self._before


class WipeHandles(bpy.types.GizmoGroup):
    """The handle in each view that compares."""

    bl_idname = "ROIGS_GGT_wipe"
    bl_label = "Compare with Photo"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"PERSISTENT", "SHOW_MODAL_ALL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The view must compare a photo."""
        return photo_wipe.frame_of(context) is not None

    def setup(self, context: bpy.types.Context) -> None:
        """Create the handle."""
        self.gizmos.new(WipeHandle.bl_idname).use_draw_modal = True


register, unregister = registration(WipeHandle, WipeHandles)
