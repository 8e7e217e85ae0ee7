"""Draws Gaussians in every 3D viewport, and in any other image."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
from mathutils import Matrix

from ..blender import region_of, region_view_of
from ..windows import Timer, redraw
from . import targets
from .handler import ViewHandler
from .objects import marked, splat_objects, surfaces_are_visible
from .painter import Painter

POLL = 0.02
"""Seconds between two looks at the threads."""

_painter: Painter | None = None


def painter() -> Painter:
    """The only one, made when it is first needed."""
    global _painter
    if _painter is None:
        _painter = Painter()
    return _painter


def problems() -> dict[str, str]:
    """Path -> why it cannot be drawn, in one line; path "" for what concerns all of them."""
    own = {"": _handler.failure} if _handler.failure else {}
    return {**own, **(_painter.problems if _painter else {})}


def draw_view(
    source: bpy.types.Context | Iterable[bpy.types.Object],
    view_matrix: Matrix,
    projection_matrix: Matrix,
    width: int,
    height: int,
) -> None:
    """Draw splats over the bound framebuffer, in sRGB values; wait for files and sorting.

    Args:
        source: a context, or the objects that may be drawn.
        view_matrix: world -> camera; the camera looks along -z, y is up.
        projection_matrix: camera -> clip space, perspective or orthographic, shifted or not.
        width: of the framebuffer, pixels.
        height: likewise.
    """
    objects = splat_objects(source) if isinstance(source, bpy.types.Context) else marked(source)
    painter().draw(
        objects, view_matrix.copy(), projection_matrix.copy(), (width, height), key="", wait=True
    )


def _draw_region(context: bpy.types.Context) -> None:
    region, data = region_of(context), region_view_of(context)
    objects = splat_objects(context)
    if not objects:
        if _painter is not None:
            _painter.forget()
        return
    size = (region.width, region.height)
    depth = targets.bound_depth(*size) if surfaces_are_visible(context) else None
    painter().draw(
        objects,
        data.view_matrix,
        data.window_matrix,
        size,
        key=region.as_pointer(),
        depth=depth,
        linear_target=True,
    )
    if painter().pending(region.as_pointer()):
        timer.start()


def _poll() -> bool:
    if _painter is None:
        return False
    if not _painter.idle():
        return True
    redraw()
    return False


timer = Timer(_poll, POLL)
"""Draws the viewports again when the threads are done."""

_handler = ViewHandler(_draw_region, "Gaussians cannot be drawn here")


def register() -> None:
    """Start drawing; in background mode there is no viewport."""
    _handler.start()


def unregister() -> None:
    """Stop drawing, end the threads, free the GPU's memory."""
    global _painter
    _handler.stop()
    timer.stop()
    if _painter is not None:
        _painter.close()
        _painter = None
