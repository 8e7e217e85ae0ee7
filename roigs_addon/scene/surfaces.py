"""Collects the triangles of a render's surfaces; the engine hides Gaussians behind them."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


def triangles(depsgraph: bpy.types.Depsgraph) -> NDArray[np.float32]:
    """(T, 3, 3) corners of all surfaces in the world, with instances, without shadow catchers.

    Args:
        depsgraph: of a render, or of a viewport; objects hidden there are left out.
    """
    known: dict[str, NDArray[np.float64]] = {}
    parts = [np.zeros((0, 3, 3))]
    for instance in depsgraph.object_instances:
        item = instance.object
        if item is None or item.type not in TYPES or not instance.show_self:
            continue
        if item.hide_render or not item.visible_camera or item.is_shadow_catcher:
            continue
        key = item.name_full
        if key not in known:
            known[key] = _of(item)
        matrix = np.array(instance.matrix_world, dtype=np.float64)
        parts.append(known[key] @ matrix[:3, :3].T + matrix[:3, 3])
    found: NDArray[np.float32] = np.concatenate(parts).astype(np.float32)
    kept: NDArray[np.float32] = found[np.isfinite(found).all(axis=(1, 2))]
    return kept


def corners(item: bpy.types.Object) -> NDArray[np.float64]:
    """(N, 3) corners of the triangles of an evaluated object, in the world."""
    matrix = np.array(item.matrix_world, dtype=np.float64)
    found: NDArray[np.float64] = _of(item).reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return found


def _of(item: bpy.types.Object) -> NDArray[np.float64]:
    """(T, 3, 3) corners of an object's surface, in its own frame."""
    mesh = item.to_mesh()
    if mesh is None:
        return np.zeros((0, 3, 3))
    mesh.calc_loop_triangles()
    corners = np.empty((len(mesh.vertices), 3), dtype=np.float32)
    mesh.vertices.foreach_get("co", corners.reshape(-1))
    rows = np.empty((len(mesh.loop_triangles), 3), dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", rows.reshape(-1))
    found = corners[rows].astype(np.float64)
    item.to_mesh_clear()
    return found


def have_catcher(depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether a shadow catcher is rendered, other than a lamp: new lamps are marked so, too."""
    shown = (item for item in depsgraph.objects if item.type != "LIGHT" and not item.hide_render)
    return any(item.is_shadow_catcher for item in shown)
