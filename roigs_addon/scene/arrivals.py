"""Shows Gaussians that came by Append, Link or a script, not by Load Results, in renders too.

A scene gets the compositor node only once, because a user may have removed it on purpose.
"""

from __future__ import annotations

import threading

import bpy

from ..blender import following, persistent
from ..properties import scene_props
from . import backgrounds, compositor, display, lookup, native_splats

_counted: dict[int, tuple[int, bool]] = {}
"""Scene (`session_uid`) -> number of its objects when last checked, and whether photos are
compared."""


def let_in(scene: bpy.types.Scene) -> None:
    """Show a scene's Gaussians in the way this Blender supports, and update background photos.

    If the engine draws them in renders, the scene gets its compositor node, unless it once had it.
    """
    for item in lookup.splats(scene):
        display.refresh(item)
    if scene.library is None and not compositor.was_linked(scene):
        compositor.link(scene)
    compositor.connect_indices(scene)
    backgrounds.follow(scene)


@persistent
def _on_change(scene: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    """Runs after every change; searches a scene only if its number of objects changed."""
    if not _in_main_thread():
        return
    if native_splats.exist():
        changed = [update.id for update in graph.updates if update.is_updated_geometry]
        meshes = {data.original for data in changed if isinstance(data, bpy.types.Mesh)}
        for item in lookup.splats(scene) if meshes else ():
            if item.data in meshes:
                display.follow(item)
    count = len(scene.objects), scene_props(scene).compare_photo
    if _counted.get(scene.session_uid) != count:
        _counted[scene.session_uid] = count
        let_in(scene)
    else:
        compositor.connect_indices(scene)


@persistent
def _on_step(*_: object) -> None:
    """Runs after undo, redo and loading a file, and before a script's render."""
    if _in_main_thread():
        _counted.clear()
        for scene in bpy.data.scenes:
            let_in(scene)


def _in_main_thread() -> bool:
    """Whether nodes may change: in a render's thread, a window may be drawing them."""
    return threading.current_thread() is threading.main_thread()


_follow, _leave = following(
    ("depsgraph_update_post", _on_change),
    ("undo_post", _on_step),
    ("redo_post", _on_step),
    ("load_post", _on_step),
    ("render_init", _on_step),
)


def register() -> None:
    """Follow changes."""
    _follow()


def unregister() -> None:
    """Stop following changes."""
    _leave()
    _counted.clear()
