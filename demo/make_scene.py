# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the demo room with bpy and photograph it with Cycles.

Writes the photos to `<out>/images/wide` and `<out>/images/close`, and the true cameras and the
bounds of the boxed objects to `<out>/truth.json`, in Blender's world frame (z up, metres).
Run `reconstruct.py` afterwards. Needs Python 3.11 and `pip install bpy==4.5.15`.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path

import bpy
import cameras
import objects
import room
from materials import Library

WIDTH, HEIGHT = 640, 428
SENSOR, LENS = 36.0, 28.0
HERE = Path(__file__).resolve().parent


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=HERE / "scene", help="folder of the scene")
    parser.add_argument(
        "--capture",
        choices=("room", "table", "moved"),
        default="room",
        help="room: the demo's photos; table: 250 around the table, whose top is a box; "
        "moved: the demo's, with things moved in a third of the wide and half of the close ones",
    )
    parser.add_argument("--samples", type=int, default=16, help="Cycles samples per pixel")
    parser.add_argument("--quality", type=int, default=80, help="JPEG quality")
    parser.add_argument("--threads", type=int, default=0, help="threads; 0 takes all")
    parser.add_argument("--only", nargs="*", default=[], help="photo names, e.g. close/vase_00")
    parser.add_argument("--keep", action="store_true", help="do not render photos that exist")
    parser.add_argument("--blend", type=Path, help="also save the scene as a .blend file")
    return parser.parse_args()


def prepare(samples: int, quality: int, threads: int) -> bpy.types.Object:
    """Create an empty scene with the render settings; returns its camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.resolution_percentage = 100
    scene.render.use_persistent_data = True
    scene.render.image_settings.file_format = "JPEG"
    scene.render.image_settings.quality = quality
    scene.render.use_motion_blur = False
    if threads:
        scene.render.threads_mode, scene.render.threads = "FIXED", threads
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
    scene.view_settings.exposure, scene.view_settings.gamma = 0.0, 1.0
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.use_adaptive_sampling = False
    cycles.seed = 1
    cycles.use_denoising = True
    cycles.denoiser = "OPENIMAGEDENOISE"
    cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 3, 2, 1
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.use_light_tree = False
    cycles.filter_width = 1.2
    camera = bpy.data.cameras.new("camera")
    camera.sensor_width, camera.lens, camera.sensor_fit = SENSOR, LENS, "HORIZONTAL"
    camera.clip_start, camera.clip_end = 0.01, 50.0
    camera.dof.use_dof = False
    obj = bpy.data.objects.new("camera", camera)
    scene.collection.objects.link(obj)
    scene.camera = obj
    return obj


def plan(capture: str) -> tuple[list[cameras.Shot], cameras.Bounds]:
    """All photos of a capture and the bounds of the boxed objects."""
    bounds = objects.bounds()
    fov = 2 * math.atan(SENSOR / 2 / LENS), 2 * math.atan(SENSOR / 2 / LENS * HEIGHT / WIDTH)
    probe = cameras.Probe(fov)
    if capture == "table":
        ends = list(zip(bounds["vase"], bounds["tin"], strict=True))
        low = [min(both) for both in zip(*ends[0], strict=True)]
        high = [max(both) for both in zip(*ends[1], strict=True)]
        return cameras.table_shots(probe), {"table": (low, high), "clock": bounds["clock"]}
    shots = cameras.wide_shots(probe)
    shots += cameras.close_shots(probe, "vase", bounds, 11)
    shots += cameras.close_shots(probe, "tin", bounds, 10)
    shots += cameras.close_shots(probe, "clock", bounds, 10, half=True)
    return shots, bounds


def is_after_the_move(shot: cameras.Shot) -> bool:
    """Whether the capture "moved" takes this photo after objects were moved."""
    kind, _, number = shot.name.removesuffix(".jpg").rpartition("_")
    return int(number) >= 40 if kind == "wide/wide" else int(number) % 2 == 1


def write_truth(path: Path, shots: list[cameras.Shot], bounds: cameras.Bounds) -> None:
    """Write camera centres, rotations (camera to world, OpenCV axes) and object bounds as JSON."""
    photos = {}
    for shot in shots:
        turn = [list(row) for row in shot.matrix().to_3x3()]
        photos[shot.name] = {
            "centre": [round(v, 6) for v in shot.eye],
            "rotation": [[round(r[0], 7), round(-r[1], 7), round(-r[2], 7)] for r in turn],
        }
    truth = {
        "frame": "Blender world: z up, metres",
        "width": WIDTH,
        "height": HEIGHT,
        "focal": LENS / SENSOR * WIDTH,
        "objects": {
            name: {"min": [round(v, 6) for v in low], "max": [round(v, 6) for v in high]}
            for name, (low, high) in bounds.items()
        },
        "photos": photos,
    }
    text = json.dumps(truth)
    path.write_text(text.replace('"close/', '\n"close/').replace('"wide/', '\n"wide/') + "\n")


def main() -> None:
    """Build, plan, render."""
    args = arguments()
    started = time.time()
    camera = prepare(args.samples, args.quality, args.threads)
    lib = Library()
    room.build_room(lib)
    objects.build_objects(lib)
    print(f"scene built in {time.time() - started:.0f} s")
    shots, bounds = plan(args.capture)
    print(f"{len(shots)} places found after {time.time() - started:.0f} s")
    args.out.mkdir(parents=True, exist_ok=True)
    if args.blend:
        bpy.ops.wm.save_as_mainfile(filepath=str(args.blend.resolve()))
    write_truth(args.out / "truth.json", shots, bounds)
    wanted = [s for s in shots if not args.only or s.name.removesuffix(".jpg") in args.only]
    if args.capture == "moved":  # photos after the move come last
        wanted.sort(key=is_after_the_move)
    moved = False
    for number, shot in enumerate(wanted, 1):
        path = args.out / "images" / shot.name
        if args.keep and path.exists():
            continue
        if args.capture == "moved" and is_after_the_move(shot) and not moved:
            objects.move_things()
            moved = True
        path.parent.mkdir(parents=True, exist_ok=True)
        camera.matrix_world = shot.matrix()
        bpy.context.scene.render.filepath = str(path)
        begun = time.time()
        bpy.ops.render.render(write_still=True)
        print(f"{number}/{len(wanted)} {shot.name}: {time.time() - begun:.1f} s", flush=True)


if __name__ == "__main__":
    main()
