"""Splats of the viewport against pictures of the engine; run by a Blender or its `bpy` module.

    blender -b --factory-startup --python viewport_parity.py -- CASE...
    python viewport_parity.py CASE...        (with bpy)

Each CASE is a folder with `splats.ply`, and maybe more whose names begin so, `cameras.json` (the
engine's camera path file) and, for each camera, the engine's picture `<name>.png`. Every camera is
drawn with the objects as they are and with the objects turned, scaled and moved, the camera going
with them, and with the picture as a part of wider windows: the picture must stay the same. One line
per picture is printed, `<name> <pose> <PSNR>`, and written as `<name>-<pose>.npy` (H, W, 4), first
row on top. Exit status 1 when a PSNR is below 35 dB, or in a wider window below 40 dB.
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

LEAST, LEAST_IN_WINDOW = 35.0, 40.0  # dB
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
WINDOWS = {"wide": (1.5, 0.1, 1.0, 0.0), "high": (0.0, 1.0, 0.2, 2.0), "far": (4.0, 3.0, 4.0, 5.0)}
"""How far a window reaches beyond the picture: left, bottom, right, top, in its sides."""


def main(folder: Path) -> bool:
    """Draw and compare everything in a case; whether all of it is similar enough."""
    items = []
    for path in sorted(folder.glob("splats*.ply")):
        item = bpy.data.objects.new(path.stem, None)
        bpy.context.scene.collection.objects.link(item)
        item.roigs.kind, item.roigs.ply = "SPLATS", str(path)
        items.append(item)
    good = True
    for camera in json.loads((folder / "cameras.json").read_text(encoding="utf-8"))["cameras"]:
        wanted = load_png(folder / f"{camera['name']}.png")
        for name, pose in POSES.items():
            drawn = draw_camera(items, camera, pose)
            quality = psnr(drawn[..., :3], wanted)
            good &= quality >= LEAST
            np.save(folder / f"{camera['name']}-{name}.npy", drawn)
            print(f"{camera['name']} {name} {quality:.2f}", flush=True)
        for name, beyond in WINDOWS.items():
            quality = psnr(draw_window(items, camera, beyond)[..., :3], wanted)
            good &= quality >= LEAST_IN_WINDOW
            print(f"{camera['name']} {name} {quality:.2f}", flush=True)
    for item in items:
        bpy.data.objects.remove(item)
    return good


def draw_window(
    items: list[bpy.types.Object], camera: dict, beyond: tuple[float, float, float, float]
) -> np.ndarray:
    """(H, W, 4) of the objects, which lie as they are, cut from a larger window."""
    for item in items:
        item.matrix_world = Matrix()
    width, height = camera["width"], camera["height"]
    sides = (width, height, width, height)
    left, bottom, right, top = (round(a * b) for a, b in zip(beyond, sides, strict=True))
    whole = {**camera, "width": left + width + right, "height": bottom + height + top}
    whole["cx"], whole["cy"] = camera["cx"] + left, camera["cy"] + top
    view = Matrix.Diagonal((1, -1, -1, 1)) @ Matrix(camera["world_to_camera"])
    frame = (float(left), float(bottom), float(left + width), float(bottom + height))
    size = whole["width"], whole["height"]
    drawn = picture(items, view, perspective(whole, NEAR, FAR), *size, frame)
    return drawn[top : top + height, left : left + width]


def draw_camera(items: list[bpy.types.Object], camera: dict, pose: Matrix) -> np.ndarray:
    """(H, W, 4) of the objects in a pose, from a camera of their own frame."""
    for item in items:
        item.matrix_world = pose
    # The camera goes with the object: what was w2c in the object's frame is w2c · pose⁻¹ in the
    # world, made rigid again by giving lengths the world's unit.
    scale = pose.to_scale()[0]
    to_camera = Matrix.Scale(scale, 4) @ Matrix(camera["world_to_camera"]) @ pose.inverted()
    view = Matrix.Diagonal((1, -1, -1, 1)) @ to_camera
    clip = perspective(camera, NEAR * scale, FAR * scale)
    return picture(items, view, clip, camera["width"], camera["height"])


if __name__ == "__main__":
    properties.register()
    try:
        given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
        passed = with_gpu(lambda: all(main(Path(folder)) for folder in given))
    finally:
        draw.unregister()
        properties.unregister()
    sys.exit(0 if passed else 1)
