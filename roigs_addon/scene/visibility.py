"""Hides objects temporarily, and restores the user's visibility.

This uses the property **Disable in Viewports**. The eye in the outliner belongs to the user, and
Alt-H shows objects that it hides.
"""

from __future__ import annotations

from contextlib import suppress

import bpy

from ..properties import object_props

SEEN = ("screen", "render")
"""Words for where a hidden object was visible before."""


def park(item: bpy.types.Object, why: str = "parked") -> None:
    """Hide an object that the result lacks, or one that is `beside` a mesh shown alone."""
    props = object_props(item)
    if not getattr(props, why):
        seen = (not item.hide_viewport, not item.hide_render)
        words = [word for word, is_seen in zip(SEEN, seen, strict=True) if is_seen]
        setattr(props, why, " ".join((why, *words)))
    item.hide_viewport = item.hide_render = True


def unpark(item: bpy.types.Object, why: str = "parked") -> None:
    """Restore a parked object's visibility."""
    props = object_props(item)
    if getattr(props, why):
        seen = getattr(props, why).split()
        item.hide_viewport, item.hide_render = (word not in seen for word in SEEN)
        setattr(props, why, "")


def wait(item: bpy.types.Object) -> None:
    """Hide an object in viewports while a preview is shown."""
    if not item.hide_viewport:
        object_props(item).waits = item.hide_viewport = True


def resume(item: bpy.types.Object) -> None:
    """Show an object again that `wait` has hidden."""
    if object_props(item).waits:
        object_props(item).waits = item.hide_viewport = False


def disable(item: bpy.types.Object) -> None:
    """Hide an object in viewports and renders."""
    item.hide_viewport = item.hide_render = True


def eye_is_shut(scene: bpy.types.Scene, item: bpy.types.Object) -> bool:
    """Whether the eye in the outliner hides an object, as H does."""
    return bool(item.hide_get(view_layer=scene.view_layers[0]))


def open_eye(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Open an object's eye in all of the scene's view layers."""
    for layer in scene.view_layers:
        with suppress(RuntimeError):  # not in this layer
            item.hide_set(False, view_layer=layer)
