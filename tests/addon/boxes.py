"""Boxes in Blender, and objects to put them around."""

from __future__ import annotations

from types import ModuleType

import numpy as np


def add_roi(bpy: ModuleType):
    bpy.ops.roigs.add_roi()
    bpy.context.view_layer.update()
    return bpy.context.active_object


def cube(bpy: ModuleType, location=(1.0, 2.0, 3.0), sides=(1.0, 2.0, 4.0)):
    mesh = bpy.data.meshes.new("cube")
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * sides
    mesh.from_pydata(corners.tolist(), [], [])
    item = bpy.data.objects.new("cube", mesh)
    item.location = location
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.objects.active = item
    bpy.context.view_layer.update()
    return item


def points_of(bpy: ModuleType, root, points: np.ndarray):
    """The sparse points of a model, which are below its root."""
    from roigs_addon.scene import clouds

    cloud = clouds.new_points("points", points.astype(np.float32))
    cloud.roigs.kind, cloud.parent = "POINTS", root
    bpy.context.scene.collection.objects.link(cloud)
    bpy.context.view_layer.update()
    return cloud


def bounds(bpy: ModuleType, roi) -> np.ndarray:
    """(2, 3) of an upright box in the world."""
    bpy.context.view_layer.update()
    corners = np.array([roi.matrix_world @ v for v in _corners(roi.empty_display_size)])
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def _corners(size: float):
    from mathutils import Vector

    steps = (-size, size)
    return [Vector((x, y, z)) for x in steps for y in steps for z in steps]
