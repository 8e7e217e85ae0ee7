"""Resolution and background photo follow the active camera, however it became active."""

from __future__ import annotations

import bpy

from ..blender import following, is_rendering, persistent
from . import cameras, lookup

_active: dict[int, int] = {}
"""Scene -> its active camera, 0 without one; both by their numbers in this session."""


@persistent
def _on_change(scene: bpy.types.Scene, *_: object) -> None:
    """Set resolution and aspect when another photo's camera has become the active one.

    A loaded file keeps its settings, and later changes by the user stay.
    """
    before = _active.get(scene.session_uid)
    remember(scene)
    camera = scene.camera
    if before is None or camera is None or before == camera.session_uid:
        return
    if not lookup.is_photo_camera(camera) and not lookup.is_suggested(camera):
        return
    if not is_rendering():  # cameras change with markers, the size must not
        cameras.activate(scene, camera)


def remember(scene: bpy.types.Scene) -> None:
    """Take the active camera as it is, with the scene's present settings."""
    _active[scene.session_uid] = scene.camera.session_uid if scene.camera is not None else 0


@persistent
def _after_undo(*_: object) -> None:
    """Remember the cameras of the undo step, which has their settings, too."""
    for scene in bpy.data.scenes:
        remember(scene)


@persistent
def _forget(*_: object) -> None:
    """Forget the active cameras before another file is loaded."""
    _active.clear()


_follow, _leave = following(
    ("depsgraph_update_post", _on_change),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
    ("load_pre", _forget),
)


def register() -> None:
    """Follow changes."""
    _follow()


def unregister() -> None:
    """Stop following changes."""
    _leave()
    _forget()
