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
from math import radians
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from roigs_addon import properties
from roigs_addon.viewport import draw
from tests.addon.pictures import load_png
from tests.blender.gpu_pictures import perspective, picture, psnr, with_gpu

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
    """Draw and compare everything in a case; whether all of it is similar enough."""
    item = bpy.data.objects.new("splats", None)
    bpy.context.scene.collection.objects.link(item)
    item.roigs.kind, item.roigs.ply = "SPLATS", str(folder / "splats.ply")
    good = True
    for camera in json.loads((folder / "cameras.json").read_text(encoding="utf-8"))["cameras"]:
        wanted = load_png(folder / f"{camera['name']}.png")
        for name, pose in POSES.items():
            item.matrix_world = pose
            drawn = draw_camera(item, camera, pose)
            quality = psnr(drawn[..., :3], wanted)
            good &= quality >= LEAST
            np.save(folder / f"{camera['name']}-{name}.npy", drawn)
            print(f"{camera['name']} {name} {quality:.2f}", flush=True)
    return good


def draw_camera(item: bpy.types.Object, camera: dict, pose: Matrix) -> np.ndarray:
    """(H, W, 4) of the object from a camera of its own frame."""
    # The camera goes with the object: what was w2c in the object's frame is w2c · pose⁻¹ in the
    # world, made rigid again by giving lengths the world's unit.
    scale = pose.to_scale()[0]
    to_camera = Matrix.Scale(scale, 4) @ Matrix(camera["world_to_camera"]) @ pose.inverted()
    view = Matrix.Diagonal((1, -1, -1, 1)) @ to_camera
    clip = perspective(camera, NEAR * scale, FAR * scale)
    return picture([item], view, clip, camera["width"], camera["height"])


if __name__ == "__main__":
    properties.register()
    try:
        passed = with_gpu(lambda: main(Path(sys.argv[-1])))
    finally:
        draw.unregister()
        properties.unregister()
    sys.exit(0 if passed else 1)
