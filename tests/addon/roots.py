"""Roots of models: where a scene was put in Blender."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from tests.poses import rotation

ROOTS = ["plain", "turned", "scaled", "turned and scaled"]


def new_root(bpy: ModuleType, kind: str):
    from mathutils import Matrix

    root = bpy.data.objects.new("root", None)
    bpy.context.scene.collection.objects.link(root)
    random = np.random.default_rng(4)
    matrix = np.eye(4)
    if "turned" in kind:
        matrix[:3, :3] = rotation(random)
        matrix[:3, 3] = 3, -2, 1
    if "scaled" in kind:
        matrix[:3, :3] *= 2.7
    root.matrix_world = Matrix(matrix.tolist())
    bpy.context.scene.roigs.root = root
    return root
