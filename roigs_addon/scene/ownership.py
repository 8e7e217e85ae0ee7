"""Tells a scene's own result from results that came by Append, Link or Take Object.

A scene and the objects of its result have the same random mark. New results of the scene change
only these objects: all others are left alone. In a .blend of an earlier version, all marks are
empty until a result is shown.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Iterator
from typing import Any

import bpy

from ..blender import following, is_local, persistent
from ..properties import object_props, scene_props
from . import lookup

Box = tuple[bool, str, str]
"""A box of a result: whether it is the scene's own one, the result's mark, and the box's name."""

KINDS = ("SPLATS", "SURFACE")
"""Of the objects that show a result."""
APPENDED = ("MAKE_LOCAL", "COPY_LOCAL")
"""What Blender does with data that it appends."""
APPENDING = "blend_import_post"
"""Blender's event, from 4.3 on."""


def is_own(scene: bpy.types.Scene, item: bpy.types.Object) -> bool:
    """Whether an object shows the scene's own result, so that a new result may change it."""
    props = object_props(item)
    shows = props.kind in KINDS and props.level != "IMPORTED"
    return shows and props.result_mark == scene_props(scene).result_mark and is_local(item)


def own_splats(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The Gaussians of the scene's own result, and of its preview."""
    return [item for item in lookup.splats(scene) if is_own(scene, item)]


def own_objects(scene: bpy.types.Scene) -> Iterator[bpy.types.Object]:
    """Gaussians and meshes of the scene's own result."""
    found = (item for kind in KINDS for item in lookup.of_kind(scene, kind))
    return (item for item in found if is_own(scene, item))


def box_of(scene: bpy.types.Scene, item: bpy.types.Object) -> Box:
    """Return the box that an object shows; other results may have boxes with the same name."""
    props = object_props(item)
    return is_own(scene, item), props.result_mark, props.roi


def own_box(scene: bpy.types.Scene, roi: str) -> Box:
    """Return a box of the scene's own result."""
    return True, scene_props(scene).result_mark, roi


def claim(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Make an object part of the scene's own result."""
    settings = scene_props(scene)
    if not settings.result_mark:
        known = list(own_objects(scene))
        settings.result_mark = _new_mark()
        for each in known:
            object_props(each).result_mark = settings.result_mark
    object_props(item).result_mark = settings.result_mark


def disown(groups: Iterable[Any]) -> None:
    """Give property groups of objects and scenes other marks; equal ones stay equal."""
    marks: dict[str, str] = {}
    for group in groups:
        group.result_mark = marks.setdefault(group.result_mark, _new_mark())


def _new_mark() -> str:
    return uuid.uuid4().hex


@persistent
def _on_append(context: Any) -> None:
    """Disown what comes from another .blend, which may be an earlier state of this one."""
    new = [entry.id for entry in context.import_items if entry.append_action in APPENDED]
    scenes = [scene_props(each) for each in new if isinstance(each, bpy.types.Scene)]
    items = [object_props(each) for each in new if isinstance(each, bpy.types.Object)]
    disown([*scenes, *(props for props in items if props.kind in KINDS)])


register, unregister = following(
    *((event, _on_append) for event in [APPENDING] if hasattr(bpy.app.handlers, event))
)
