# SPDX-License-Identifier: GPL-3.0-or-later
"""The captured scene with the things in it, as the add-on shows it: a folder for each row.

Needs `bpy` and what `surface --background` needs; `python -m benchmarks.insertion ours` runs it.
The add-on's own operators set all up, and Blender's F12 renders: what a user gets. Pictures are
those of the truth: linear light (H, W, 3), `-with`, `-without`, and `-lamp`.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np

import roigs_addon
from benchmarks.insertion import things
from benchmarks.insertion.views import ROWS, picture_file
from roigs_addon import settings
from roigs_addon.engine.command import Engine
from roigs_addon.geometry.photo import Photo
from roigs_addon.properties import scene_props
from roigs_addon.scene import box_surfaces, cameras, importing, relight, splats, stage_world
from roigs_addon.scene.image_pixels import pixels_of
from roigs_addon.stage_properties import stage_props
from roigs_engine.app.run_scene import cameras_of_run
from roigs_engine.context import QUIET

ROOT = Path(__file__).resolve().parents[2]
AT = (0.0, 0.0, 0.9)
"""Where the light's picture is taken: above the middle of the table."""
NOTHING, MEAN, LIGHT, CATCH, ALL = ROWS
GREY = 0.05
"""Blender's own world, linear."""


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path, help="run of the demo, which gets the background's mesh")
    parser.add_argument("out", type=Path, help="folder of the row's pictures")
    parser.add_argument("--row", choices=ROWS, default=ALL)
    parser.add_argument("--photos", nargs="+", required=True, help="names of photos")
    parser.add_argument("--width", type=int, default=320, help="pixels")
    parser.add_argument("--samples", type=int, default=64, help="Cycles' samples of a pixel")
    parser.add_argument("--lamp", action="store_true", help="the relit vase with the lamp, instead")
    parser.add_argument(
        "--engine-python",
        type=Path,
        default=Path(sys.executable),
        help="a Python with torch; default: this one",
    )
    return parser.parse_args()


def captured(run: Path, photos: list[str], width: int, python: Path) -> tuple[Any, dict[str, Any]]:
    """A scene with a run's result, and a camera for each photo; the engine runs in `python`."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene: Any = bpy.context.scene
    engine = Engine(python=python, source=ROOT)
    settings.engine = lambda packages: engine
    props = scene_props(scene)
    props.run_dir = str(run)
    known = cameras_of_run(run, None, QUIET)
    root: Any = bpy.data.objects.new("root", None)
    scene.collection.objects.link(root)
    props.root = root
    splats.show_results(scene, run)
    box_surfaces.load(scene, run)
    views = {}
    for image in known.select(photos).images:
        record = {
            "name": image.name,
            "world_to_camera": image.world_to_camera.tolist(),
            **vars(image.camera.resized(width, round(width * 428 / 640))),
        }
        views[image.name] = cameras.new_camera(
            Photo.from_dict(record), known.extent() * importing.CAMERA_SIZE
        )
        scene.collection.objects.link(views[image.name])
    return scene, views


def set_up(scene: Any, samples: int) -> None:
    """Cycles as the truth's, but for the photos' pixel filter, which is the engine's own."""
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.samples, cycles.seed = "CYCLES", samples, 1
    cycles.use_adaptive_sampling, cycles.use_denoising = False, True
    cycles.max_bounces, cycles.diffuse_bounces = 12, 2
    cycles.glossy_bounces = cycles.transmission_bounces = 8
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.filter_width = 1.2
    render.use_persistent_data = True
    render.film_transparent = True
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_mode, render.image_settings.color_depth = "RGB", "32"
    scene.view_settings.view_transform = "Standard"


def stage(scene: Any, row: str) -> None:
    """The add-on's settings of the row."""
    operators: Any = getattr(bpy.ops, "roigs")  # noqa: B009
    world: Any = bpy.data.worlds.new("grey")
    if world.node_tree is None:
        world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (GREY, GREY, GREY, 1.0)
    scene.world = world
    scene.cursor.location = AT
    if row == NOTHING:
        return
    operators.light_from_scene(where="CURSOR")
    if row == MEAN:
        background.inputs["Color"].default_value = (*_mean_colour(scene), 1.0)
        operators.remove_stage()
        scene.world = world
    elif row in (CATCH, ALL):
        operators.catch_shadows()
        stage_props(scene).catches, stage_props(scene).reflects = True, row == ALL


def _mean_colour(scene: Any) -> list[float]:
    """Of the picture that the world shines with, by solid angle."""
    world: Any = stage_world.light(scene)
    node = next(n for n in world.node_tree.nodes if n.type == "TEX_ENVIRONMENT")
    picture = pixels_of(node.image)[..., :3]
    rows = np.cos(np.pi * ((np.arange(len(picture)) + 0.5) / len(picture) - 0.5))
    mean: list[float] = (picture.mean(axis=1) * rows[:, None]).sum(axis=0).tolist()
    return [value / rows.sum() for value in mean]


def f12(scene: Any, view: Any, path: Path) -> None:
    """Render what a camera sees, and write it."""
    if path.exists():
        return
    cameras.activate(scene, view)
    begun, exr = time.time(), path.with_suffix(".exr")
    scene.render.filepath = str(exr)
    bpy.ops.render.render(write_still=True)
    image: Any = bpy.data.images.load(str(exr))
    np.save(path, pixels_of(image)[::-1, :, :3].astype(np.float16))
    bpy.data.images.remove(image)
    exr.unlink()
    print(f"{path.name}: {time.time() - begun:.0f} s", flush=True)


def main() -> None:
    """Make the pictures that are not there."""
    args = arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    roigs_addon.register()
    try:
        scene, views = captured(args.run.resolve(), args.photos, args.width, args.engine_python)
        set_up(scene, args.samples)
        stage(scene, args.row)
        if args.lamp:
            lamp, vase = things.put_lamp(), box_surfaces.surface_of(scene, "vase")
            assert vase is not None
            operators: Any = getattr(bpy.ops, "roigs")  # noqa: B009
            operators.relight(name=vase.name)
            assert relight.is_on(vase)
            made, states = [lamp], ("without", "lamp")
        else:
            made, states = list(things.put_things().values()), ("without", "with")
        for name, view in views.items():
            for state in states:
                for thing in made:
                    thing.hide_render = state == "without"
                f12(scene, view, picture_file(args.out, name, state))
    finally:
        roigs_addon.unregister()


if __name__ == "__main__":
    main()
