"""Hides the cube of Blender's start file, which stands in the middle of an imported model."""

from __future__ import annotations

import bpy
import numpy as np

from ..blender import mesh_of
from .clouds import positions
from .visibility import disable

NAME, CORNERS = "Cube", 8


def untouched(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The start file's cube, unless the user has changed anything about it."""
    item = scene.objects.get(NAME)
    return item if item is not None and _is_as_it_was(item) else None


def hide(scene: bpy.types.Scene) -> None:
    """Hide the start file's cube in views and renders; it stays in the outliner."""
    item = untouched(scene)
    if item is not None:
        disable(item)


def _is_as_it_was(item: bpy.types.Object) -> bool:
    if item.type != "MESH" or item.library or len(mesh_of(item).vertices) != CORNERS:
        return False
    users_own = (item.parent, item.children, item.modifiers, item.constraints, item.animation_data)
    moved = not np.array_equal(np.array(item.matrix_basis), np.eye(4))
    return not any(users_own) and not moved and bool((np.abs(positions(item)) == 1).all())
