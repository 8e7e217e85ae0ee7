"""Resolution and background photo follow the active camera, however it became active."""

from __future__ import annotations

import bpy

from ..blender import is_rendering, persistent
from . import cameras, lookup

_active: dict[str, str] = {}  # scene -> its active camera, by name


@persistent
def follow(scene: bpy.types.Scene, *_: object) -> None:
    """Set resolution and aspect when another photo's camera has become the active one.

    A loaded file keeps its settings, and later changes by the user stay.
    """
    camera = scene.camera
    name = camera.name if camera else ""
    before = _active.get(scene.name)
    _active[scene.name] = name
    if before is None or before == name or not camera:
        return
    if not lookup.is_photo_camera(camera) and not lookup.is_suggested(camera):
        return
    if not is_rendering():  # cameras change with markers, the size must not
        cameras.activate(scene, camera)


@persistent
def forget(*_: object) -> None:
    """Forget the active cameras before another file is loaded."""
    _active.clear()


def register() -> None:
    """Add the handlers."""
    bpy.app.handlers.depsgraph_update_post.append(follow)
    bpy.app.handlers.load_pre.append(forget)


def unregister() -> None:
    """Remove the handlers."""
    bpy.app.handlers.load_pre.remove(forget)
    bpy.app.handlers.depsgraph_update_post.remove(follow)
    forget()
