"""Draws a photo left of a line, and the Gaussians right of it, in a view through its camera."""

from __future__ import annotations

from typing import Any, cast

import blf
import bpy
import gpu
from gpu_extras.batch import batch_for_shader

from .. import blender
from ..blender import region_of, region_view_of, scene_of
from ..geometry.photo_places import Frame
from ..properties import scene_props
from ..scene import backgrounds, lookup, masks
from . import marks, photo_overlay
from .handler import ViewHandler

LINE = (1.0, 1.0, 1.0, 0.9)
SHADE, BACK = (0.0, 0.0, 0.0, 0.55), (0.0, 0.0, 0.0, 0.7)
WIDTH, LETTERS, GAP, EDGE = 2.0, 13.0, 10.0, 4.0
"""Sizes of the line, letters, and space around them, in pixels at an interface scale of 1."""


def frame_of(context: bpy.types.Context) -> Frame | None:
    """Return the camera's frame in a region that compares a photo, else None."""
    scene = scene_of(context)
    masked = scene_props(scene).show_masks and lookup.active_roi(context) is not None
    if masked or not backgrounds.is_compared(scene):
        return None
    return photo_overlay.frame_of(context)


def line_of(context: bpy.types.Context, frame: Frame) -> float:
    """Return the place of the line, in pixels from the region's left."""
    share: float = scene_props(scene_of(context)).wipe
    return frame[0] + share * (frame[2] - frame[0])


def _draw(context: bpy.types.Context) -> None:
    frame, photo = frame_of(context), masks.photo_at_hand(context)
    if frame is None or photo is None:
        return
    wipe = scene_props(scene_of(context)).wipe
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("ALPHA")
    photo_overlay.image(photo_overlay.texture(backgrounds.shown(photo)), frame, wipe)
    scale, x, region = blender.interface_scale(), line_of(context, frame), region_of(context)
    bottom, gap = max(frame[1], 0.0) + GAP * scale, GAP * scale
    middle = (bottom + min(frame[3], region.height)) / 2
    ends = [(x, frame[1]), (x, frame[3])]
    for side in (-gap, gap):
        tip = (x + 1.8 * side, middle)
        ends += [(x + side, middle + gap), tip, tip, (x + side, middle - gap)]
    _lines(region, ends, WIDTH * scale)
    _say("Photo", x - gap, bottom, scale, left_of=True)
    _say("Result", x + gap, bottom, scale)
    gpu.state.blend_set("NONE")
    _draw_marks(context)


def _draw_marks(context: bpy.types.Context) -> None:
    """Draw the boxes again over the photo, which hides them."""
    view, matrix = region_view_of(context), cast(Any, gpu.matrix)
    with matrix.push_pop(), matrix.push_pop_projection():
        matrix.load_matrix(view.view_matrix)
        matrix.load_projection_matrix(view.window_matrix)
        marks.draw(context)


def _lines(region: bpy.types.Region, ends: list[tuple[float, float]], width: float) -> None:
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": [(x, y, 0.0) for x, y in ends]})
    shader.bind()
    shader.uniform_float("viewportSize", (region.width, region.height))
    for colour, wide in ((SHADE, 2.5 * width), (LINE, width)):
        shader.uniform_float("lineWidth", wide)
        shader.uniform_float("color", colour)
        batch.draw(shader)


def _say(text: str, x: float, y: float, scale: float, *, left_of: bool = False) -> None:
    blf.size(0, LETTERS * scale)
    wide, high = blf.dimensions(0, text)
    left, edge = x - wide if left_of else x, EDGE * scale
    low, right, top = y - edge, left + wide + edge, y + high + edge
    corners = [(left - edge, low), (right, low), (right, top), (left - edge, top)]
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    gpu.state.blend_set("ALPHA")  # letters end it
    shader.bind()
    shader.uniform_float("color", BACK)
    batch_for_shader(shader, "TRI_FAN", {"pos": [(a, b, 0.0) for a, b in corners]}).draw(shader)
    blf.position(0, left, y, 0)
    blf.color(0, *LINE)
    blf.draw(0, text)


_handler = ViewHandler(_draw, "Photos cannot be compared here", after="POST_PIXEL")
problem, register, unregister = _handler.problem, _handler.start, _handler.stop
