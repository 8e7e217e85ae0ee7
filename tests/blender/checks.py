"""Shared code of the checks in Blender: objects, a picture, and how they are run."""

from __future__ import annotations

import sys
from math import radians
from pathlib import Path
from typing import Any

import bpy
import gpu
import numpy as np
from mathutils import Matrix

from roigs_addon import properties
from roigs_addon.viewport import draw, points
from roigs_addon.viewport.objects import marked
from roigs_addon.viewport.painter import Painter
from roigs_addon.viewport.view import View
from tests.blender.gpu_pictures import perspective, with_gpu

SIDE = 96
DISTANCE = 4.0
FOLDER = Path(sys.argv[-1])
TURN = Matrix.Rotation(radians(40), 4, "Y") @ Matrix.Rotation(radians(25), 4, "X")


def splats(name: str, path: Path) -> bpy.types.Object:
    """An object that stands for a PLY."""
    item = bpy.data.objects.new(name, None)
    bpy.context.scene.collection.objects.link(item)
    item.roigs.kind, item.roigs.ply = "SPLATS", str(path)
    return item


def glance(item: bpy.types.Object, size: float, painter: Painter, **how: bool) -> np.ndarray:
    """A picture through a lens with which the object's `coarser` is 1 / `size`."""
    focal = 0.4 * SIDE * DISTANCE * size
    camera = {"width": SIDE, "height": SIDE, "fx": focal, "fy": focal, "cx": SIDE / 2}
    clip = perspective({**camera, "cy": SIDE / 2}, 0.1, 100)
    view = View(Matrix.Translation((0, 0, -DISTANCE)) @ TURN, clip, (SIDE, SIDE))
    offscreen = gpu.types.GPUOffScreen(SIDE, SIDE, format="RGBA32F")
    objects = marked([item], scene=bpy.context.scene)
    with offscreen.bind():
        gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 0.0))
        painter.draw(objects, view, key=0, **how)
        data = offscreen.texture_color.read()
    data.dimensions = SIDE * SIDE * 4
    offscreen.free()
    return np.array(data).reshape(SIDE, SIDE, 4)


def run_checks(names: dict[str, Any]) -> None:
    """Do a script's checks with the folder's two objects, each on its own, and leave Blender.

    `names` are the script's globals; those that begin with `check_` are its checks.
    """

    def all_pass() -> bool:
        a, b = splats("a", FOLDER / "a.ply"), splats("b", FOLDER / "b.ply")
        for check in (value for name, value in names.items() if name.startswith("check_")):
            check(a, b)
            print(check.__name__, "passed", flush=True)
        return True

    properties.register()
    points.register()
    try:
        passed = with_gpu(all_pass)
    finally:
        draw.unregister()
        points.unregister()
        properties.unregister()
    sys.exit(0 if passed else 1)
