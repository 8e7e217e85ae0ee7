"""Pictures of the viewport's splats without a window, for the scripts beside this."""

from __future__ import annotations

import traceback
from collections.abc import Callable

import bpy
import gpu
import numpy as np
from mathutils import Matrix

from roigs_addon.scene import native_splats
from roigs_addon.viewport import draw
from roigs_addon.viewport.objects import marked
from roigs_addon.viewport.view import Frame, View


def picture(
    objects: list[bpy.types.Object],
    view: Matrix,
    projection: Matrix,
    width: int,
    height: int,
    frame: Frame | None = None,
    strength: float = 1.0,
) -> np.ndarray:
    """(H, W, 4) premultiplied sRGB values of objects, first row on top."""
    offscreen = gpu.types.GPUOffScreen(width, height, format="RGBA32F")
    with offscreen.bind():
        gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 0.0))
        place = View(view, projection, (width, height), frame)
        draw.painter().draw(marked(objects), place, key="", strength=strength, wait=True)
        data = offscreen.texture_color.read()
    data.dimensions = width * height * 4
    offscreen.free()
    return np.array(data, np.float32).reshape(height, width, 4)[::-1]


def perspective(camera: dict, near: float, far: float) -> Matrix:
    """Clip space of a pinhole camera with any principal point."""
    width, height = camera["width"], camera["height"]
    return Matrix(
        (
            (2 * camera["fx"] / width, 0, 1 - 2 * camera["cx"] / width, 0),
            (0, 2 * camera["fy"] / height, 2 * camera["cy"] / height - 1, 0),
            (0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)),
            (0, 0, -1, 0),
        )
    )


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """dB, of values in 0 to 1; values outside are clipped."""
    error = np.mean((np.clip(a, 0, 1) - np.clip(b, 0, 1)) ** 2, dtype=float)
    return float(-10 * np.log10(max(error, 1e-12)))


def with_gpu(task: Callable[[], bool]) -> bool:
    """Do `task` where the GPU can be used without a window, and the add-on draws all Gaussians.

    Blender 5.2 can start it; before, only the `render()` of a render engine that asks for it has
    it.
    """
    native_splats.exist = lambda: False
    if hasattr(gpu, "init"):
        gpu.init()
        return task()
    results = []

    class Engine(bpy.types.RenderEngine):
        bl_idname = "ROIGS_PARITY"
        bl_label = "Parity"
        bl_use_gpu_context = True

        def render(self, _depsgraph: bpy.types.Depsgraph) -> None:
            try:
                results.append(task())
            except Exception:
                traceback.print_exc()

    bpy.utils.register_class(Engine)
    try:
        scene = bpy.context.scene
        scene.render.engine = Engine.bl_idname
        scene.render.resolution_x = scene.render.resolution_y = 16
        bpy.ops.render.render()
    finally:
        bpy.utils.unregister_class(Engine)
    return bool(results) and results[0]
