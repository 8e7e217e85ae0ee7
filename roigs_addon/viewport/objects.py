"""Finds the objects to draw as Gaussians."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace

import bpy
from mathutils import Matrix

from ..blender import view_layer_of, windows
from ..properties import object_props
from ..scene import display, edits, heat_map, instances, ladders, look

SURFACES = frozenset(
    {
        *("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"),
        *("GPENCIL", "GREASEPENCIL"),
    }
)
"""Types of objects that can hide Gaussians."""


@dataclass(frozen=True)
class FileKey:
    """A file with its time and size. A changed file has another key and is read again."""

    path: str
    modified: int  # ns
    size: int

    @classmethod
    def of(cls, path: str) -> FileKey:
        """Return the key of a file as it is now; raises OSError."""
        state = os.stat(path)
        return cls(path, state.st_mtime_ns, state.st_size)


@dataclass(frozen=True, eq=False)
class Levels:
    """An object's levels of detail, and keys of their present files."""

    detail: ladders.Detail
    files: tuple[FileKey, ...]


@dataclass(frozen=True)
class SplatObject:
    """An object of the scene that shows a PLY."""

    file: FileKey
    matrix: Matrix  # the file's frame -> world
    visible: bool
    gains: look.Gains
    density: float = 1.0
    levels: Levels | None = None


def splat_objects(context: bpy.types.Context) -> list[SplatObject]:
    """Return all objects of the .blend that show a PLY, visible in this context or not.

    Objects that another window shows also belong to the set on the GPU.
    """
    space, scene = context.space_data, context.scene
    return marked(bpy.data.objects, space, scene) + _instanced(context)


def marked(
    objects: Iterable[bpy.types.Object],
    space: bpy.types.Space | None = None,
    scene: bpy.types.Scene | None = None,
) -> list[SplatObject]:
    """Return those of `objects` that show an existing PLY.

    Args:
        objects: to search.
        space: decides their visibility; None for visibility anywhere.
        scene: with the settings of levels of detail; None for no levels.
    """
    found = []
    for item in objects:
        if object_props(item).kind != "SPLATS" or display.is_native(item, viewport=True):
            continue
        if (one := _of(item, scene)) is not None:
            shown = object_props(item).shown_as != "POINTS" and seen(item, space)
            found.append(replace(one, matrix=item.matrix_world @ one.matrix, visible=shown))
    return found


def _instanced(context: bpy.types.Context) -> list[SplatObject]:
    """Return the instances in all windows; those in this view are visible."""
    own, found = view_layer_of(context), []
    layers = {layer.as_pointer(): layer for layer in (own, *(w.view_layer for w in windows()))}
    known: dict[int, SplatObject | None] = {}
    for layer in layers.values():
        for each in instances.in_view(layer):
            uid = each.item.session_uid
            if uid not in known:
                native = display.is_native(each.item)
                known[uid] = None if native else _of(each.item, context.scene)
            if (one := known[uid]) is not None:
                shown = layer == own and seen(each.instancer, context.space_data)
                matrix = Matrix(each.matrix.tolist()) @ one.matrix
                found.append(replace(one, matrix=matrix, visible=shown))
    return found


def _of(item: bpy.types.Object, scene: bpy.types.Scene | None) -> SplatObject | None:
    """Return an object as if at the origin; None without a PLY."""
    hot = heat_map.shown(item)
    path, frame = hot or (edits.file_of(item), edits.frame_of(item))
    try:
        file = FileKey.of(path)
    except OSError:
        return None
    matrix = Matrix(frame.tolist())
    if hot:
        return SplatObject(file, matrix, True, look.AS_IT_IS)
    return SplatObject(file, matrix, True, look.gains(item), levels=_levels(item, scene))


def _levels(item: bpy.types.Object, scene: bpy.types.Scene | None) -> Levels | None:
    detail = ladders.of(item, scene)
    if detail is None:
        return None
    try:
        return Levels(detail, tuple(map(FileKey.of, detail.files)))
    except OSError:  # one is missing: the object is drawn whole
        return None


def are_edited(context: bpy.types.Context) -> bool:
    """Whether the points of some Gaussians are in edit mode."""
    if context.mode != "EDIT_MESH":
        return False
    return any(object_props(item).kind == "SPLATS" for item in context.objects_in_mode)


def surfaces_are_visible(context: bpy.types.Context) -> bool:
    """Whether the view shows anything that could hide Gaussians."""
    return any(
        item.type in SURFACES
        and (object_props(item).kind != "SPLATS" or object_props(item).shown_as == "POINTS")
        and item.display_type in ("SOLID", "TEXTURED")
        and seen(item, context.space_data)
        for item in view_layer_of(context).objects
    )


def seen(item: bpy.types.Object, space: bpy.types.Space | None) -> bool:
    """Whether the object is visible; if `space` is a 3D view, in it, with its local view."""
    if isinstance(space, bpy.types.SpaceView3D):
        return item.visible_get(viewport=space)
    return item.visible_get()
