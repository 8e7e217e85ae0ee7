"""Which objects are drawn as Gaussians."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass

import bpy
from mathutils import Matrix

SURFACES = frozenset(
    {
        *("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"),
        *("GPENCIL", "GREASEPENCIL"),
    }
)
"""Types of objects that can hide Gaussians."""


@dataclass(frozen=True)
class FileKey:
    """One state of a file; another one of the same path is read again."""

    path: str
    modified: int  # ns
    size: int


@dataclass(frozen=True)
class SplatObject:
    """An object of the scene that stands for a PLY."""

    file: FileKey
    matrix: Matrix  # object -> world
    visible: bool


def splat_objects(context: bpy.types.Context) -> list[SplatObject]:
    """All objects of the file that stand for a PLY, whether this context shows them or not.

    Those that another window shows belong to the set on the GPU, too.
    """
    return marked(bpy.data.objects, context.space_data)


def marked(
    objects: Iterable[bpy.types.Object], space: bpy.types.Space | None = None
) -> list[SplatObject]:
    """Those of `objects` that stand for a PLY that exists; visible in `space`, if one is given."""
    found = []
    for thing in objects:
        path = thing.roigs.ply
        if thing.roigs.kind != "SPLATS" or not path:
            continue
        try:
            state = os.stat(path)
        except OSError:
            continue
        found.append(
            SplatObject(
                FileKey(path, state.st_mtime_ns, state.st_size),
                thing.matrix_world.copy(),
                not thing.roigs.as_points and seen(thing, space),
            )
        )
    return found


def surfaces_are_visible(context: bpy.types.Context) -> bool:
    """Is there anything in the view that could hide Gaussians?"""
    return any(
        thing.type in SURFACES
        and (thing.roigs.kind != "SPLATS" or thing.roigs.as_points)
        and thing.display_type in ("SOLID", "TEXTURED")
        and seen(thing, context.space_data)
        for thing in context.view_layer.objects
    )


def seen(thing: bpy.types.Object, space: bpy.types.Space | None) -> bool:
    """Is the object visible, in `space` when that is a 3D view (which may be in local view)?"""
    if space is not None and space.type == "VIEW_3D":
        return thing.visible_get(viewport=space)
    return thing.visible_get()
