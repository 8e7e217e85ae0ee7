"""Gaussians in Blender's own renders (F12): asks the engine for each frame's layer beforehand.

The compositor merges the layer with Blender's picture (scene/compositor.py).

A render calls `render_pre`, then puts the frame's objects in their places and calls
`frame_change_post`, then renders. In a window this happens in the render's own thread, so waiting
here does not freeze it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

import bpy
import numpy as np

from . import settings
from .blender import persistent
from .engine.frame_engine import FrameEngine
from .engine.python import FOR_TRAINING
from .errors import AddonError
from .jobs import options_files
from .scene import blur, compositor, edits, proxies, shadow_pass, stage
from .scene.frame_request import frame_request, picture, rays, shown
from .shared import EngineError, frame_requests, scratch

NAME = "roigs-splats"
"""Of the frame's files, before its number."""

problem = ""
"""Why the last render lacks Gaussians, in one line; empty if it does not."""

_waiting = False
"""Whether a frame is about to be rendered and its layer is not drawn yet."""

_engine: FrameEngine | None = None
_requests: tuple[Path, BinaryIO] | None = None


@persistent
def before_frame(scene: bpy.types.Scene, *_: object) -> None:
    """A frame will be rendered; its objects are not in their places yet."""
    global _waiting
    _waiting = compositor.find(scene) is not None
    if shadow_pass.multiplies(scene):  # the engine may be another one than when that was set
        shadow_pass.connect(scene)
        stage.free_lamps(scene)
    proxies.settle(scene)  # the user may have chosen other ways to show boxes since


@persistent
def frame_is_set(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Have the frame's layer drawn, if this is a frame of a render."""
    global problem, _waiting
    if not _waiting or depsgraph is None:
        return
    _waiting, problem = False, ""
    try:
        problem = _draw(scene, depsgraph)
    except (AddonError, EngineError, OSError) as error:
        problem = str(error)
    if problem:
        print(f"ROI-GS: {problem}")


def _draw(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> str:
    global _engine
    # Blender's own temporary folder: no other Blender writes there, and it can be written to.
    out = Path(bpy.app.tempdir) / NAME
    for old in out.parent.glob(f"{out.name}*"):  # only one frame's files are kept
        old.unlink()
    frame = out.with_name(f"{out.name}{max(scene.frame_current, 0):04d}")
    _, _, width, height = picture(scene.render)
    mattes = compositor.uses_mattes(scene)
    frame_requests.write_nothing(frame, width, height, mattes=mattes)
    compositor.point_to(scene, out)
    try:
        moments = blur.moments(scene, depsgraph)
        if moments:
            transparent = scene.render.film_transparent
            request: Any = blur.request(moments, frame, transparent=transparent)
        else:
            request = frame_request(scene, depsgraph, str(frame))
            if request is not None and (along := rays(scene, depsgraph)) is not None:
                request["rays"] = f"{frame}-rays.npy"
                np.save(request["rays"], along)
        if request is None:
            return ""
        if _engine is None or not _engine.alive():
            _end_engine()
            _engine = _started()
        items = shown(scene)
        drawn = _engine.draw(request | {"mattes": mattes})
        samples = request.get("samples", [request])
        known = {model["object_index"] for sample in samples for model in sample["models"]}
        lost = blur.remark(scene, depsgraph, moments) or compositor.empty_mattes(scene, known)
        return drawn or lost or edits.problem(items) or edits.remark(items)
    finally:
        compositor.reload(scene)


def _started() -> FrameEngine:
    global _requests
    _requests = scratch.new_scratch("roigs-frames-")
    engine, options = settings.engine(FOR_TRAINING), options_files.machine_options()
    return FrameEngine(engine, _requests[0], options)


@persistent
def after_render(*_: object) -> None:
    """End the engine; the last frame's files stay for the compositor."""
    global _waiting
    _waiting = False
    _end_engine()


def _end_engine() -> None:
    global _engine, _requests
    if _engine is not None:
        _engine.close()
        _engine = None
    if _requests is not None:
        scratch.remove_scratch(*_requests)
        _requests = None


def _handlers() -> list[tuple[list[Any], Any]]:
    known: Any = bpy.app.handlers
    return [
        (known.render_pre, before_frame),
        (known.frame_change_post, frame_is_set),
        (known.render_complete, after_render),
        (known.render_cancel, after_render),
    ]


def register() -> None:
    """Follow renders."""
    for place, handler in _handlers():
        place.append(handler)


def unregister() -> None:
    """Follow none, and end an engine that draws."""
    for place, handler in _handlers():
        if handler in place:
            place.remove(handler)
    after_render()
