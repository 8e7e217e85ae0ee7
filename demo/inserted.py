# SPDX-License-Identifier: GPL-3.0-or-later
"""The truth: the demo's room, rendered from its photos' cameras without and with the things.

Needs `bpy`; `python -m benchmarks.insertion truth` runs it. What is there already is not made
again. Pictures are NumPy files (H, W, 3) of linear light; the photos are these with Blender's view
transform Standard.

    python demo/inserted.py OUT --photos wide/wide_005.jpg ... --width 320
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from make_scene import HEIGHT, HERE, WIDTH, prepare
from masks import pose
from materials import Library
from objects import build_objects
from room import build_room

sys.path.insert(0, str(HERE.parent))

from benchmarks.insertion import things
from benchmarks.insertion.views import VASE, picture_file

STATES = ("with", "without", "lamp")


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of the pictures")
    parser.add_argument("--photos", nargs="+", required=True, help="names of photos")
    parser.add_argument("--states", nargs="*", default=STATES, choices=STATES)
    parser.add_argument("--width", type=int, default=320, help="pixels")
    parser.add_argument("--samples", type=int, default=64, help="Cycles' samples of a pixel")
    return parser.parse_args()


def room(samples: int, width: int) -> Any:
    """Build the demo's room, set it up as its photos were, and return the camera.

    A path through glass needs more bounces than the photos had; matt surfaces keep their two. The
    room's lamps, which no photo shows, are also hidden from mirrors and glass.
    """
    camera = prepare(samples, 80, 0)
    scene: Any = bpy.context.scene
    lib = Library()
    build_room(lib)
    build_objects(lib)
    scene.render.resolution_x, scene.render.resolution_y = width, round(width * HEIGHT / WIDTH)
    scene.cycles.max_bounces = 12
    scene.cycles.glossy_bounces = scene.cycles.transmission_bounces = 8
    for thing in scene.objects:
        if thing.type == "LIGHT":
            thing.visible_glossy = thing.visible_transmission = False
        if thing.get("roi") == "vase":
            thing.pass_index = VASE
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.color_depth = "32"
    return camera


def rendered(path: Path, channels: int = 3) -> Any:
    """Render the scene in its current state to (H, W, channels)."""
    scene: Any = bpy.context.scene
    exr = path.with_suffix(".exr")
    scene.render.filepath = str(exr)
    bpy.ops.render.render(write_still=True)
    image: Any = bpy.data.images.load(str(exr))
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    height, width = image.size[1], image.size[0]
    bpy.data.images.remove(image)
    exr.unlink()
    return values.reshape(height, width, 4)[::-1, :, :channels]


def show(made: dict[str, Any], lamp: Any, state: str) -> None:
    """Show only the objects of a state."""
    for thing in made.values():
        thing.hide_render = state != "with"
    lamp.hide_render = state != "lamp"


def index_pictures(names: list[str], poses: dict[str, Any], camera: Any, out: Path) -> None:
    """Write the thing at each pixel's centre: 0 for none, else its number, `VASE` for the vase."""
    scene: Any = bpy.context.scene
    wanted = [name for name in names if not picture_file(out, name, "index").exists()]
    if not wanted:
        return
    before = [(slot, slot.material) for thing in scene.objects for slot in thing.material_slots]
    flat: dict[int, Any] = {}
    for thing in scene.objects:
        for slot in thing.material_slots:
            number = thing.pass_index
            flat[number] = flat.get(number) or _shining(number)
            slot.material = flat[number]
    kept = {name: getattr(scene.cycles, name) for name in ("samples", "filter_width")}
    scene.cycles.use_denoising, scene.cycles.samples, scene.cycles.filter_width = False, 1, 0.01
    for name in wanted:
        camera.matrix_world = poses[name]
        path = picture_file(out, name, "index")
        np.save(path, np.rint(rendered(path)[..., 0]).astype(np.uint8))
    for name, value in kept.items():
        setattr(scene.cycles, name, value)
    scene.cycles.use_denoising = True
    for slot, material in before:
        slot.material = material


def _shining(number: int) -> Any:
    """A material that emits a number."""
    material: Any = bpy.data.materials.new(f"index {number}")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    glow, out = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    glow.inputs["Strength"].default_value = number
    glow.inputs["Color"].default_value = (1, 1, 1, 1)
    material.node_tree.links.new(glow.outputs[0], out.inputs["Surface"])
    return material


def main() -> None:
    """Make the missing pictures."""
    args = arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    camera = room(args.samples, args.width)
    made, lamp = things.put_things(), things.put_lamp()
    truth = json.loads((HERE / "scene/truth.json").read_text("utf-8"))["photos"]
    poses = {name: pose(truth[name]) for name in args.photos}
    show(made, lamp, "with")
    index_pictures(args.photos, poses, camera, args.out)
    for name in args.photos:
        for state in args.states:
            show(made, lamp, state)
            path = picture_file(args.out, name, state)
            if path.exists():
                continue
            camera.matrix_world, begun = poses[name], time.time()
            np.save(path, rendered(path).astype(np.float16))
            print(f"{path.name}: {time.time() - begun:.0f} s", flush=True)


if __name__ == "__main__":
    main()
