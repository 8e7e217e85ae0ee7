# SPDX-License-Identifier: GPL-3.0-or-later
"""Write true masks of the demo's objects, to measure `roigs_engine cut` with.

Builds the room as `make_scene.py` does, and renders each object in a plain colour, all else black.
Writes `<out>/ROI/PHOTO.jpg.png`, white where the photo shows the object. Needs `pip install
bpy==4.5.15`.

    python demo/masks.py --out masks --photos close/vase_00 close/vase_03
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import bpy
import numpy as np
import objects
import room
from make_scene import HEIGHT, HERE, WIDTH, prepare
from materials import Library
from mathutils import Matrix


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the masks")
    parser.add_argument("--photos", nargs="*", default=[], help="photo names; all if none is given")
    return parser.parse_args()


def paint(rois: list[str]) -> None:
    """Make object k emit only colour k of red, green and blue, and everything else black."""
    scene = bpy.context.scene
    scene.world = None
    for obj in list(scene.objects):
        if obj.type == "LIGHT":
            bpy.data.objects.remove(obj)
        elif hasattr(obj.data, "materials"):
            obj.data.materials.clear()
            obj.data.materials.append(plain([float(obj.get("roi") == roi) for roi in rois]))
    scene.render.image_settings.file_format = "PNG"
    scene.cycles.use_denoising = False
    scene.cycles.filter_width = 0.01  # a ray through the centre of each pixel
    scene.cycles.max_bounces = 0


def plain(colour: list[float]) -> bpy.types.Material:
    """A material that emits a colour."""
    name = f"plain {colour}"
    if name in bpy.data.materials:
        return bpy.data.materials[name]
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    light, out = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("Emission", "OutputMaterial"))
    light.inputs["Color"].default_value = (*colour, 1.0)
    tree.links.new(light.outputs["Emission"], out.inputs["Surface"])
    return material


def pose(camera: dict) -> Matrix:
    """The camera of `truth.json` in Blender's axes."""
    matrix = Matrix(camera["rotation"]).to_4x4() @ Matrix.Diagonal((1, -1, -1, 1))
    matrix.translation = camera["centre"]
    return matrix


def rendered(matrix: Matrix, camera: bpy.types.Object) -> np.ndarray:
    """Render to (H, W, 3): whether each pixel shows each of the three objects."""
    with tempfile.TemporaryDirectory() as folder:
        camera.matrix_world = matrix
        bpy.context.scene.render.filepath = path = str(Path(folder, "mask.png"))
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(path)
        pixels = np.empty(HEIGHT * WIDTH * 4, np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
    return pixels.reshape(HEIGHT, WIDTH, 4)[::-1, :, :3] > 0.5


def write_mask(path: Path, mask: np.ndarray) -> None:
    """Write a mask (H, W) as a grey PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = bpy.data.images.new("mask", WIDTH, HEIGHT)
    pixels = np.ones((HEIGHT, WIDTH, 4), np.float32)
    pixels[..., :3] = mask[::-1, :, None]
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


def main() -> None:
    """Build the room, and write the masks of the photos."""
    args = arguments()
    truth = json.loads((HERE / "scene/truth.json").read_text())
    rois = list(truth["objects"])
    camera = prepare(1, 80, 0)
    lib = Library()
    room.build_room(lib)
    objects.build_objects(lib)
    paint(rois)
    for name, place in truth["photos"].items():
        if args.photos and name.removesuffix(".jpg") not in args.photos:
            continue
        shown = rendered(pose(place), camera)
        for k, roi in enumerate(rois):
            write_mask(args.out / roi / f"{name}.png", shown[..., k])
        print(name, dict(zip(rois, shown.sum((0, 1)).tolist(), strict=True)), flush=True)


if __name__ == "__main__":
    main()
