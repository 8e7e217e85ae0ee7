"""Places of scenes, for tests of placing them."""

from __future__ import annotations

from types import ModuleType

import numpy as np


def matrix(scene) -> np.ndarray:
    import bpy

    bpy.context.view_layer.update()
    return np.array(scene.roigs.root.matrix_world)


def moved(world: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ world[:3, :3].T + world[:3, 3]


def select_points(bpy: ModuleType, scene, chosen: np.ndarray) -> np.ndarray:
    """Sparse points in edit mode; returns them in the COLMAP frame."""
    from roigs_addon.scene import clouds, lookup

    cloud = lookup.points(scene)
    bpy.context.view_layer.objects.active = cloud
    bpy.ops.object.mode_set(mode="OBJECT")
    flags = np.zeros(len(cloud.data.vertices), bool)
    flags[chosen] = True
    cloud.data.vertices.foreach_set("select", flags)
    cloud.data.update()
    bpy.ops.object.mode_set(mode="EDIT")
    return clouds.positions(cloud)[chosen]


def triangle(scene) -> np.ndarray:
    """Rows of three sparse points that span a large plane."""
    from roigs_addon.scene import clouds, lookup

    points = clouds.positions(lookup.points(scene))
    return np.array([points[:, 0].argmin(), points[:, 0].argmax(), points[:, 2].argmax()])
