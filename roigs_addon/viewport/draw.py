"""Draws Gaussians in every 3D viewport."""

from __future__ import annotations

import bpy

from ..blender import region_of, region_view_of
from ..windows import Timer, redraw, redraw_sidebars
from . import targets
from .handler import ViewHandler
from .objects import are_edited, splat_objects, surfaces_are_visible
from .painter import Painter
from .view import View, camera_frame

POLL = 0.02
"""Seconds between two checks of the threads."""

REST = 0.2
"""Seconds without a change after which a view that was drawn coarsely is drawn in full."""

FAINT = 0.3
"""Strength of all Gaussians while some are in edit mode, so that selected points stay visible."""

_painter: Painter | None = None


def painter() -> Painter:
    """Return the only painter, created at the first call."""
    global _painter
    if _painter is None:
        _painter = Painter()
    return _painter


def problems() -> dict[str, str]:
    """Return path -> why it cannot be drawn, in one line; path "" is for all objects."""
    own = {"": _handler.failure} if _handler.failure else {}
    return {**own, **(_painter.problems if _painter else {})}


def counts(area: bpy.types.Area | None) -> tuple[int, int] | None:
    """Return the numbers of Gaussians in a 3D view: drawn, and without levels of detail."""
    if _painter is None or area is None:
        return None
    keys = (region.as_pointer() for region in area.regions if region.type == "WINDOW")
    return next((_painter.counts[key] for key in keys if key in _painter.counts), None)


def _draw_region(context: bpy.types.Context) -> None:
    region, data = region_of(context), region_view_of(context)
    objects = splat_objects(context)
    if not objects:
        if _painter is not None:
            _painter.forget()
        return
    size = (region.width, region.height)
    frame = camera_frame(context, data.window_matrix, size)
    depth = targets.bound_depth(*size) if surfaces_are_visible(context) else None
    before = painter().counts.get(region.as_pointer())
    coarse = painter().draw(
        objects,
        View(data.view_matrix, data.window_matrix, size, frame),
        key=region.as_pointer(),
        depth=depth,
        linear_target=True,
        strength=FAINT if are_edited(context) else 1.0,
        rested=not moving.running,
    )
    if coarse:
        moving.stop()
        moving.start()
    if painter().counts.get(region.as_pointer()) != before:
        counted.start()
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
"""Redraws the viewports when the threads are done."""


def _rest() -> bool:
    redraw()
    return False


moving = Timer(_rest, REST)
"""Draws a coarse view in full after it has not changed for `REST` seconds."""


def _say() -> bool:
    redraw_sidebars()
    return False


counted = Timer(_say, REST)
"""Redraws the panel after the number of drawn Gaussians has changed."""

_handler = ViewHandler(_draw_region, "Gaussians cannot be drawn here")


def register() -> None:
    """Start drawing; in background mode there is no viewport."""
    _handler.start()


def unregister() -> None:
    """Stop drawing, end the threads, free the GPU's memory."""
    global _painter
    _handler.stop()
    timer.stop()
    moving.stop()
    counted.stop()
    if _painter is not None:
        _painter.close()
        _painter = None
