"""Marks the points that a user is picking in the 3D view."""

from __future__ import annotations

import bpy
import gpu
from bpy_extras import view3d_utils
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

from .. import blender
from ..blender import region_of, region_view_of
from .handler import ViewHandler

PICKED, HOVERED = (1.0, 0.85, 0.1, 1.0), (1.0, 1.0, 1.0, 0.9)
ARM, WIDTH = 9.0, 2.0
"""Half of a cross and the width of lines, in pixels at an interface scale of 1."""

picked: list[Vector] = []
"""The points, in the world."""

hovered: list[Vector] = []
"""The point under the mouse, if there is one."""


def show(points: list[Vector], under: Vector | None) -> None:
    """Mark points, and the one under the mouse."""
    picked[:], hovered[:] = points, [] if under is None else [under]
    _handler.start()


def hide() -> None:
    """Remove all marks."""
    picked.clear()
    hovered.clear()
    _handler.stop()


def _draw(context: bpy.types.Context) -> None:
    region, view = region_of(context), region_view_of(context)
    scale = blender.interface_scale()
    places = [view3d_utils.location_3d_to_region_2d(region, view, point) for point in picked]
    seen = [place for place in places if place is not None]
    between = [end for k in range(len(seen) - 1) for end in (seen[k], seen[k + 1])]
    crosses = [end for place in seen for end in _cross(place, ARM * scale)]
    _lines(region, [*between, *crosses], PICKED, WIDTH * scale)
    under = [view3d_utils.location_3d_to_region_2d(region, view, point) for point in hovered]
    rings = [end for place in under if place is not None for end in _square(place, ARM * scale)]
    _lines(region, rings, HOVERED, WIDTH * scale)


def _cross(place: Vector, arm: float) -> list[Vector]:
    x, y = Vector((arm, 0)), Vector((0, arm))
    return [place - x, place + x, place - y, place + y]


def _square(place: Vector, arm: float) -> list[Vector]:
    corners = [place + Vector((x, y)) * arm for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return [end for k in range(4) for end in (corners[k], corners[(k + 1) % 4])]


def _lines(
    region: bpy.types.Region, ends: list[Vector], colour: tuple[float, ...], width: float
) -> None:
    if not ends:
        return
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": [(end.x, end.y, 0.0) for end in ends]})
    shader.bind()
    shader.uniform_float("viewportSize", (region.width, region.height))
    shader.uniform_float("lineWidth", width)
    shader.uniform_float("color", colour)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("NONE")
    batch.draw(shader)
    gpu.state.blend_set("NONE")


_handler = ViewHandler(_draw, "Picked points cannot be drawn here", after="POST_PIXEL")
