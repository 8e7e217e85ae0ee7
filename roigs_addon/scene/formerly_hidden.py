"""Migrates objects that earlier versions hid with the outliner's eye, which Alt-H opens."""

from __future__ import annotations

import bpy

from ..blender import is_local, persistent
from ..properties import object_props
from . import detail, lookup, ownership, start_cube
from .visibility import SEEN, disable, eye_is_shut, open_eye, wait


def take_over(scene: bpy.types.Scene) -> None:
    """Hide such objects in this version's way. Objects that the user hid with H stay hidden."""
    items = [item for item in lookup.splats(scene) if is_local(item)]
    training = any(map(_is_preview, items))
    for item in (item for item in items if eye_is_shut(scene, item)):
        props = object_props(item)
        if props.parked:
            if not _was_parked(item):
                continue
        elif item.hide_render and _other_is_shown(scene, item):
            detail.switch_off(item)
        elif training:
            wait(item)
        else:
            continue
        open_eye(scene, item)
    others = (lookup.points(scene), start_cube.untouched(scene))
    for other in (each for each in others if each is not None and is_local(each)):
        if other.hide_render and eye_is_shut(scene, other):
            disable(other)
            open_eye(scene, other)


def _is_preview(item: bpy.types.Object) -> bool:
    """Whether an object is an earlier version's preview: it has no mark."""
    props = object_props(item)
    return bool(props.level == "PREVIEW" and not props.result_mark)


def _was_parked(item: bpy.types.Object) -> bool:
    """Park an object in the new way; return whether it was visible before it was parked."""
    props = object_props(item)
    words = props.parked.split()
    if "view" not in words:
        return False
    words.remove("view")
    if not item.hide_viewport:
        words.append(SEEN[0])
    props.parked = " ".join(words)
    item.hide_viewport = True
    return True


def _other_is_shown(scene: bpy.types.Scene, item: bpy.types.Object) -> bool:
    """Whether the other object of the box is shown, as earlier versions switched them."""
    own = object_props(item)
    if own.level not in (detail.FINE, detail.COARSE):
        return False
    box = ownership.box_of(scene, item)
    same = [other for other in lookup.splats(scene) if ownership.box_of(scene, other) == box]
    others = [o for o in same if object_props(o).level not in (own.level, "RESULT", "PREVIEW")]
    shown = any(not eye_is_shut(scene, other) for other in others)
    return shown and not any(object_props(other).off for other in others)


@persistent
def _after_load(*_: object) -> None:
    for scene in bpy.data.scenes:
        if scene.library is None:
            take_over(scene)


def register() -> None:
    """Check each loaded file."""
    bpy.app.handlers.load_post.append(_after_load)


def unregister() -> None:
    """Stop checking files."""
    bpy.app.handlers.load_post.remove(_after_load)
