"""Coloured lines over the 3D view: boxes, and the photos chosen for the active one.

Blender draws empties and cameras in its theme's colours, whatever colour the object has.
"""

from __future__ import annotations

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

from .. import lookup

BOX, CHOSEN = (1.0, 0.55, 0.1, 1.0), (0.2, 0.9, 0.4, 1.0)
WIDTH = 1.6
"""Pixels, at an interface scale of 1."""

_CORNERS = [Vector((x, y, z)) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
_EDGES = [(a, b) for a in range(8) for b in range(a) if (a ^ b) in (1, 2, 4)]

_handler: object | None = None


def _draw() -> None:
    """The handler: Blender calls it for each 3D viewport."""
    context = bpy.context
    space = context.space_data
    if not space.overlay.show_overlays or not space.overlay.show_extras:
        return
    boxes = [roi for roi in lookup.rois(context.scene) if roi.visible_get(viewport=space)]
    active = lookup.active_roi(context)
    _lines(context, [p for roi in boxes for p in box_lines(roi)], BOX)
    if active is not None and len(active.roigs.selection):
        names = {item.name for item in active.roigs.selection}
        cameras = lookup.named_cameras(context.scene, names)
        seen = [c for c in cameras if c != context.scene.camera and c.visible_get(viewport=space)]
        _lines(context, [p for c in seen for p in camera_lines(c, context.scene)], CHOSEN)


def box_lines(roi: bpy.types.Object) -> list[Vector]:
    """Ends of a box's edges in world space, two by two."""
    matrix, half = roi.matrix_world, roi.empty_display_size
    corners = [matrix @ (corner * half) for corner in _CORNERS]
    return [corners[end] for edge in _EDGES for end in edge]


def camera_lines(camera: bpy.types.Object, scene: bpy.types.Scene) -> list[Vector]:
    """Ends of the lines of a camera's frame, as Blender draws it, two by two."""
    matrix = camera.matrix_world
    frame = [matrix @ corner for corner in camera.data.view_frame(scene=scene)]
    eye = matrix.translation
    # `view_frame` is at a distance of its own; Blender's drawing is `display_size` wide.
    wide = max((frame[0] - frame[3]).length, (frame[0] - frame[1]).length)
    size = camera.data.display_size * float(np.mean(matrix.to_scale())) / max(wide, 1e-12)
    corners = [eye + (corner - eye) * size for corner in frame]
    around = [end for k in range(4) for end in (corners[k], corners[(k + 1) % 4])]
    return around + [end for corner in corners for end in (eye, corner)]


def _lines(context: bpy.types.Context, ends: list[Vector], colour: tuple[float, ...]) -> None:
    if not ends:
        return
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": ends})
    shader.bind()
    shader.uniform_float("viewportSize", (context.region.width, context.region.height))
    shader.uniform_float("lineWidth", WIDTH * context.preferences.system.ui_scale)
    shader.uniform_float("color", colour)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("NONE")  # Blender's own lines are at the same depth
    batch.draw(shader)
    gpu.state.blend_set("NONE")


def register() -> None:
    """Start to draw; in background mode there is no viewport."""
    global _handler
    if _handler is None and not bpy.app.background:
        _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister() -> None:
    """Stop."""
    global _handler
    if _handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
        _handler = None
