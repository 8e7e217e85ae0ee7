"""Draws the erase brush in the 3D view: its circle, and the Gaussians under its stroke."""

from __future__ import annotations

import math
from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from numpy.typing import NDArray

from .. import blender
from ..blender import region_of
from .chosen import COLOUR, WIDTH, point_shader
from .handler import ViewHandler

CIRCLE, CORNERS = (1.0, 1.0, 1.0, 0.9), 48
MOST = 200_000
"""Most points drawn; more look the same."""

_at: tuple[int, float, float, float] | None = None
"""Region (address), the circle's centre in it, and its radius, in pixels."""

_below: NDArray[np.float32] = np.empty((0, 2), np.float32)


def show(region: bpy.types.Region, centre: tuple[float, float], radius: float) -> None:
    """Show the circle in a region; centre and radius in pixels."""
    global _at
    _at = region.as_pointer(), *centre, radius
    _handler.start()


def mark(places: NDArray[Any]) -> None:
    """Mark points under the stroke, (N, 2) in pixels of the region."""
    global _below
    _below = np.asarray(places[:: 1 + len(places) // MOST], np.float32)


def hide() -> None:
    """Hide the circle and the marks."""
    global _at
    _at = None
    mark(np.empty((0, 2)))
    _handler.stop()


def _draw(context: bpy.types.Context) -> None:
    region = region_of(context)
    if _at is None or region.as_pointer() != _at[0]:
        return
    _, x, y, radius = _at
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("NONE")
    if len(_below):
        points: Any = np.column_stack((_below, np.zeros(len(_below), np.float32)))
        shader = point_shader()
        shader.bind()
        shader.uniform_float("color", COLOUR)
        gpu.state.point_size_set(WIDTH * blender.interface_scale())
        batch_for_shader(shader, "POINTS", {"pos": points}).draw(shader)
        gpu.state.point_size_set(1.0)
    turns = [2 * math.pi * step / CORNERS for step in range(CORNERS + 1)]
    ring = [(x + radius * math.cos(a), y + radius * math.sin(a), 0.0) for a in turns]
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    batch = batch_for_shader(shader, "LINE_STRIP", {"pos": ring})
    shader.bind()
    shader.uniform_float("viewportSize", (region.width, region.height))
    shader.uniform_float("lineWidth", 1.5 * blender.interface_scale())
    shader.uniform_float("color", CIRCLE)
    batch.draw(shader)
    gpu.state.blend_set("NONE")


_handler = ViewHandler(_draw, "The brush cannot be drawn here", after="POST_PIXEL")
