"""Splats of the viewport against pictures of the engine; run by a Blender or its `bpy` module.

    blender -b --factory-startup --python viewport_parity.py -- CASE
    python viewport_parity.py CASE        (with bpy)

CASE is a folder with `splats.ply`, `cameras.json` (the engine's camera path file) and, for each
camera, the engine's picture `<name>.png`. Every camera is drawn with the object as it is and with
the object turned, scaled and moved, the camera going with it: the picture must stay the same. One
line per picture is printed, `<name> <pose> <PSNR>`, and written as `<name>-<pose>.npy` (H, W, 4),
first row on top. Exit status 1 when a PSNR is below 35 dB.
"""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable
from math import radians
from pathlib import Path

import bpy
import gpu
import numpy as np
from mathutils import Matrix, Vector

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from roigs_addon.viewport import draw

LEAST = 35.0  # dB
NEAR, FAR = 0.01, 1000.0  # clip planes, units of the object
POSES = {
    "plain": Matrix(),
    "x90": Matrix.Rotation(radians(90), 4, "X"),
    "y90": Matrix.Rotation(radians(90), 4, "Y"),
    "z90": Matrix.Rotation(radians(90), 4, "Z"),
    "moved": Matrix.LocRotScale(
        Vector((3, -2, 1)), Matrix.Rotation(1.1, 3, Vector((1, 2, 3))), Vector((2.5, 2.5, 2.5))
    ),
}


def main(folder: Path) -> bool:
    """Draw and compare everything in a case; is it all alike enough?"""
    thing = bpy.data.objects.new("splats", None)
    bpy.context.scene.collection.objects.link(thing)
    thing["roigs_splats"] = str(folder / "splats.ply")
    good = True
    for camera in json.loads((folder / "cameras.json").read_text(encoding="utf-8"))["cameras"]:
        wanted = load_png(folder / f"{camera['name']}.png")
        for name, pose in POSES.items():
            thing.matrix_world = pose
            picture = draw_camera(thing, camera, pose)
            quality = psnr(picture[..., :3], wanted)
            good &= quality >= LEAST
            np.save(folder / f"{camera['name']}-{name}.npy", picture)
            print(f"{camera['name']} {name} {quality:.2f}", flush=True)
    return good


def draw_camera(thing: bpy.types.Object, camera: dict, pose: Matrix) -> np.ndarray:
    """(H, W, 4) of the object from a camera of its own frame."""
    # The camera goes with the object: what was w2c in the object's frame is w2c · pose⁻¹ in the
    # world, made rigid again by giving lengths the world's unit.
    scale = pose.to_scale()[0]
    to_camera = Matrix.Scale(scale, 4) @ Matrix(camera["world_to_camera"]) @ pose.inverted()
    view = Matrix.Diagonal((1, -1, -1, 1)) @ to_camera
    clip = projection(camera, NEAR * scale * 0.5, FAR * scale)
    return render(thing, view, clip, camera["width"], camera["height"])


def render(
    thing: bpy.types.Object, view: Matrix, projection: Matrix, width: int, height: int
) -> np.ndarray:
    """(H, W, 4) premultiplied sRGB values of one object, first row on top."""
    offscreen = gpu.types.GPUOffScreen(width, height, format="RGBA32F")
    with offscreen.bind():
        gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 0.0))
        draw.draw_view([thing], view, projection, width, height)
        data = offscreen.texture_color.read()
    data.dimensions = width * height * 4
    picture = np.array(data, np.float32).reshape(height, width, 4)[::-1]
    offscreen.free()
    return picture


def projection(camera: dict, near: float, far: float) -> Matrix:
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


def load_png(path: Path) -> np.ndarray:
    """(H, W, 3) sRGB values, first row on top."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.zeros(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1, :, :3]


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """dB, of values in 0 to 1."""
    error = np.mean((np.clip(a, 0, 1) - b) ** 2, dtype=float)
    return float(-10 * np.log10(max(error, 1e-12)))


def with_gpu(task: Callable[[], bool]) -> bool:
    """Do `task` where the GPU can be used without a window.

    Blender 5.2 can start it; before, only the `render()` of a render engine that asks for it has
    it.
    """
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


if __name__ == "__main__":
    try:
        passed = with_gpu(lambda: main(Path(sys.argv[-1])))
    finally:
        draw.unregister()
    sys.exit(0 if passed else 1)
