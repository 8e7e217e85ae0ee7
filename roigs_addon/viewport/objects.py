"""Which objects are drawn as Gaussians."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass

import bpy
from mathutils import Matrix

from ..blender import view_layer_of
from ..properties import object_props
from ..scene import edits, ladders, look

SURFACES = frozenset(
    {
        *("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"),
        *("GPENCIL", "GREASEPENCIL"),
    }
)
"""Types of objects that can hide Gaussians."""


@dataclass(frozen=True)
class FileKey:
    """A file in one state; if it has changed, it is read again."""

    path: str
    modified: int  # ns
    size: int

    @classmethod
    def of(cls, path: str) -> FileKey:
        """A file as it is now; raises OSError."""
        state = os.stat(path)
        return cls(path, state.st_mtime_ns, state.st_size)


@dataclass(frozen=True, eq=False)
class Levels:
    """The levels of detail of an object, and their files as they are now."""

    detail: ladders.Detail
    files: tuple[FileKey, ...]


@dataclass(frozen=True)
class SplatObject:
    """An object of the scene that stands for a PLY."""

    file: FileKey
    matrix: Matrix  # the file's frame -> world
    visible: bool
    gains: look.Gains
    density: float = 1.0
    levels: Levels | None = None


def splat_objects(context: bpy.types.Context) -> list[SplatObject]:
    """All objects of the .blend that stand for a PLY, whether this context shows them or not.

    Those that another window shows also belong to the set on the GPU.
    """
    return marked(bpy.data.objects, context.space_data, context.scene)


def marked(
    objects: Iterable[bpy.types.Object],
    space: bpy.types.Space | None = None,
    scene: bpy.types.Scene | None = None,
) -> list[SplatObject]:
    """Those of `objects` that stand for an existing PLY.

    Args:
        objects: to look through.
        space: in which they are visible or not; None: anywhere.
        scene: whose settings say how levels of detail are chosen; None: objects have none.
    """
    found = []
    for item in objects:
        props = object_props(item)
        path = edits.file_of(item) if props.kind == "SPLATS" else ""
        if not path:
            continue
        try:
            file = FileKey.of(path)
        except OSError:
            continue
        found.append(
            SplatObject(
                file,
                item.matrix_world @ Matrix(edits.frame_of(item).tolist()),
                not props.as_points and seen(item, space),
                look.gains(item),
                levels=_levels(item, scene),
            )
        )
    return found


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
        and (object_props(item).kind != "SPLATS" or object_props(item).as_points)
        and item.display_type in ("SOLID", "TEXTURED")
        and seen(item, context.space_data)
        for item in view_layer_of(context).objects
    )


def seen(item: bpy.types.Object, space: bpy.types.Space | None) -> bool:
    """Whether the object is visible; in `space` if that is a 3D view, maybe in local view."""
    if isinstance(space, bpy.types.SpaceView3D):
        return item.visible_get(viewport=space)
    return item.visible_get()
