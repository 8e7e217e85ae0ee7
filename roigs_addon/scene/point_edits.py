"""Selects and deletes points of Gaussian objects. The selection is edit mode's."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bmesh
import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import is_local, mesh_of, scene_of
from ..errors import AddonError
from ..properties import object_props
from . import clouds, lookup
from .splat_attributes import hidden, values

Mask = NDArray[np.bool_]

NONE = "There are no Gaussians to clean up. Show or select some."


def targets(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the Gaussian objects to clean up: the selected ones, or all visible if none is.

    Of objects that share their points, it returns only one.
    """
    return distinct(chosen_or_visible(context))


def chosen_or_visible(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the visible Gaussian objects that are selected, or all visible if none is."""
    seen = visible(context)
    return [i for i in seen if i.select_get(view_layer=context.view_layer)] or seen


def distinct(items: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return objects without those that share their points with an earlier one."""
    first: dict[int, bpy.types.Object] = {}
    for item in items:
        first.setdefault(mesh_of(item).session_uid, item)
    return list(first.values())


def visible(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The Gaussian objects that are visible and can be edited."""
    own = [i for i in lookup.splats(scene_of(context)) if _is_editable(i)]
    return [i for i in own if i.visible_get(view_layer=context.view_layer)]


def checked_targets(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return `targets`; raises AddonError if there are none."""
    items = targets(context)
    if not items:
        raise AddonError(NONE)
    return items


def _is_editable(item: bpy.types.Object) -> bool:
    if not isinstance(item.data, bpy.types.Mesh) or object_props(item).level == "PREVIEW":
        return False
    return is_local(item) and is_local(item.data) and bool(len(item.data.vertices))


def places(item: bpy.types.Object) -> NDArray[np.float64]:
    """(N, 3) of an object's points in the world."""
    world = lookup.matrix_world(item)
    return np.asarray(clouds.positions(item) @ world[:3, :3].T + world[:3, 3])


def scales(item: bpy.types.Object) -> NDArray[np.float64]:
    """(N, 3) standard deviations, in units of the world."""
    found = values(mesh_of(item), "scale")
    if found is None:
        raise AddonError(f"'{item.name}' is no longer an object of Gaussians. Import it again.")
    return np.asarray(found * np.cbrt(abs(np.linalg.det(lookup.matrix_world(item)[:3, :3]))))


def opacities(item: bpy.types.Object) -> NDArray[np.float32]:
    """(N,) opacities, 0 to 1."""
    found = values(mesh_of(item), "radiance:base")
    if found is None:
        raise AddonError(f"'{item.name}' is no longer an object of Gaussians. Import it again.")
    return found[:, 3]


def inside(item: bpy.types.Object, box: bpy.types.Object, scene: bpy.types.Scene) -> Mask:
    """(N,) which points are in a box; raises AddonError if the object is not a box."""
    root = lookup.from_world(scene)
    placed = places(item) @ root[:3, :3].T + root[:3, 3]
    return lookup.box(box, scene).contains(placed.astype(np.float32))


def choose(item: bpy.types.Object, mask: Mask, *, extend: bool = False) -> int:
    """Select points, and no others unless `extend`; returns the number of selected points."""
    mesh = mesh_of(item)
    mask = mask & ~hidden(mesh)
    if extend:
        mask |= chosen(item)
    mesh.vertices.foreach_set("select", mask)
    for edges in (mesh.edges, mesh.polygons):  # of joined meshes
        edges.foreach_set("select", np.zeros(len(edges), bool))
    mesh.update()
    return int(mask.sum())


def chosen(item: bpy.types.Object) -> Mask:
    """(N,) which points are selected and not hidden."""
    mesh = mesh_of(item)
    found = np.zeros(len(mesh.vertices), bool)
    mesh.vertices.foreach_get("select", found)
    return found & ~hidden(mesh)


def count_chosen(items: Iterable[bpy.types.Object]) -> int:
    """Number of selected points of objects."""
    return sum(int(chosen(item).sum()) for item in items)


def remove(item: bpy.types.Object, mask: Mask) -> int:
    """Delete points that are not hidden; returns how many."""
    mesh = mesh_of(item)
    rows = np.flatnonzero(mask & ~hidden(mesh))
    if not len(rows):
        return 0
    if mesh.shape_keys is not None:
        raise AddonError(f"'{item.name}' has shape keys. Delete points in edit mode.")
    edited = bmesh.new()
    try:
        edited.from_mesh(mesh)
        edited.verts.ensure_lookup_table()
        found: Any = [edited.verts[row] for row in rows.tolist()]
        bmesh.ops.delete(edited, geom=found, context="VERTS")
        edited.to_mesh(mesh)
    finally:
        edited.free()
    mesh.update()
    return len(rows)
