"""Draws coloured lines in the 3D view: boxes, photos selected for the active box, excluded photos.

Blender itself draws empties and cameras in its theme's colours, not in the object's colour.
"""

from __future__ import annotations

import bpy
import gpu
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix, Vector

from .. import blender
from ..blender import camera_of, region_of, scene_of
from ..properties import object_props, scene_props
from ..scene import lookup
from .handler import ViewHandler

BOX, CHOSEN = (1.0, 0.55, 0.1, 1.0), (0.2, 0.9, 0.4, 1.0)
EXCLUDED = (0.85, 0.25, 0.2, 1.0)
Colour = tuple[float, ...]
WIDTH = 1.6
"""Pixels, at an interface scale of 1."""

_CORNERS = [Vector((x, y, z)) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
_EDGES = [(a, b) for a in range(8) for b in range(a) if (a ^ b) in (1, 2, 4)]


def draw(context: bpy.types.Context) -> None:
    """Draw the lines, in the world's frame."""
    space, scene = blender.view_3d_of(context), scene_of(context)
    if space is None or not space.overlay.show_overlays or not space.overlay.show_extras:
        return
    boxes = [roi for roi in lookup.rois(scene) if roi.visible_get(viewport=space)]
    active = lookup.active_roi(context)
    _lines(context, [p for roi in boxes for p in box_lines(roi)], BOX)
    if active is not None and len(object_props(active).selection):
        _cameras(context, space, {item.name for item in object_props(active).selection}, CHOSEN)
    _cameras(context, space, {item.name for item in scene_props(scene).excluded}, EXCLUDED)


def _cameras(
    context: bpy.types.Context, space: bpy.types.SpaceView3D, photos: set[str], colour: Colour
) -> None:
    scene = scene_of(context)
    cameras = lookup.named_cameras(scene, photos)
    seen = [c for c in cameras if c != scene.camera and c.visible_get(viewport=space)]
    _lines(context, [end for c in seen for end in camera_lines(c, scene)], colour)


def box_lines(roi: bpy.types.Object) -> list[Vector]:
    """Return the ends of a box's edges in world space, in pairs."""
    matrix, half = roi.matrix_world, roi.empty_display_size
    corners = [matrix @ (corner * half) for corner in _CORNERS]
    return [corners[end] for edge in _EDGES for end in edge]


def camera_lines(camera: bpy.types.Object, scene: bpy.types.Scene) -> list[Vector]:
    """Return the ends of the lines of a camera, as Blender draws it, in pairs."""
    matrix, data = camera.matrix_world, camera_of(camera)
    frame = [matrix @ corner for corner in data.view_frame(scene=scene)]
    eye = matrix.translation
    # `view_frame` is at some other distance; Blender draws a frame `display_size` wide.
    wide = max((frame[0] - frame[3]).length, (frame[0] - frame[1]).length)
    size = data.display_size * _mean_scale(matrix) / max(wide, 1e-12)
    corners = [eye + (corner - eye) * size for corner in frame]
    around = [end for k in range(4) for end in (corners[k], corners[(k + 1) % 4])]
    return around + [end for corner in corners for end in (eye, corner)]


def _mean_scale(matrix: Matrix) -> float:
    scale = matrix.to_scale()
    return (scale.x + scale.y + scale.z) / 3


def _lines(context: bpy.types.Context, ends: list[Vector], colour: Colour) -> None:
    if not ends:
        return
    region = region_of(context)
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": [(end.x, end.y, end.z) for end in ends]})
    shader.bind()
    shader.uniform_float("viewportSize", (region.width, region.height))
    shader.uniform_float("lineWidth", WIDTH * blender.interface_scale())
    shader.uniform_float("color", colour)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("NONE")  # Blender's own lines are at the same depth
    batch.draw(shader)
    gpu.state.blend_set("NONE")


_handler = ViewHandler(draw, "Boxes cannot be drawn here")
problem, register, unregister = _handler.problem, _handler.start, _handler.stop
