"""Draws Gaussians in every 3D viewport, and in any picture that is asked for."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
from mathutils import Matrix

from . import targets
from .handler import ViewHandler
from .objects import marked, splat_objects, surfaces_are_visible
from .painter import Painter

POLL = 0.02
"""Seconds between looks at what the threads have done."""

_painter: Painter | None = None


def painter() -> Painter:
    """The one of this session, made when it is first needed."""
    global _painter
    if _painter is None:
        _painter = Painter()
    return _painter


def problems() -> dict[str, str]:
    """Path -> why it cannot be drawn, in one line; path "" for what concerns all."""
    own = {"": _handler.failure} if _handler.failure else {}
    return {**own, **(_painter.problems if _painter else {})}


def draw_view(
    source: bpy.types.Context | Iterable[bpy.types.Object],
    view_matrix: Matrix,
    projection_matrix: Matrix,
    width: int,
    height: int,
) -> None:
    """Draw splats over the bound framebuffer, in sRGB values; waits for files and sorting.

    Args:
        source: a context, or the objects that may be drawn.
        view_matrix: world -> camera; the camera looks along -z, y is up.
        projection_matrix: camera -> clip space, perspective or orthographic, shifted or not.
        width: of the framebuffer, pixels.
        height: likewise.
    """
    things = splat_objects(source) if isinstance(source, bpy.types.Context) else marked(source)
    painter().draw(
        things, Matrix(view_matrix), Matrix(projection_matrix), (width, height), key="", wait=True
    )


def _draw_region(context: bpy.types.Context) -> None:
    region, data = context.region, context.region_data
    things = splat_objects(context)
    if not things:
        if _painter is not None:
            _painter.forget()
        return
    size = (region.width, region.height)
    depth = targets.bound_depth(*size) if surfaces_are_visible(context) else None
    painter().draw(
        things,
        data.view_matrix,
        data.window_matrix,
        size,
        key=region.as_pointer(),
        depth=depth,
        linear_target=True,
    )
    if painter().pending(region.as_pointer()) and not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=POLL)


def _poll() -> float | None:
    """Have the viewports drawn again when the threads are done."""
    if _painter is None:
        return None
    if not _painter.idle():
        return POLL
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
    return None


_handler = ViewHandler(_draw_region, "Gaussians cannot be drawn here")


def register() -> None:
    """Add the handler; in background mode there is no viewport."""
    _handler.start()


def unregister() -> None:
    """Remove the handler, end the threads, free the GPU's memory."""
    global _painter
    _handler.stop()
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)
    if _painter is not None:
        _painter.close()
        _painter = None
