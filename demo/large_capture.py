# SPDX-License-Identifier: GPL-3.0-or-later
"""Photograph the demo's room five hundred times, as a person with an automatic camera would.

    python demo/large_capture.py --out large

Writes what each photo's sensor sees (`<out>/linear`, half-precision EXR, before exposure and tone
mapping), develops it to JPEG with true EXIF (`<out>/images`, or `--photos`), and writes the true
cameras, exposures and faults to `<out>/truth.json`. Views without any fault, to measure with, are
in `<out>/images_held_out`, at the exposure in the middle of the photos'. Stopped, the same command
resumes; photos that are rendered are only developed again. `--check` compares what it develops with
Blender's own pictures.
Needs Python 3.11 and `pip install bpy==4.5.15 pillow`.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from fractions import Fraction
from pathlib import Path

import bpy
import large_shots
import numpy as np
import objects
import room
from build import linear
from cameras import Bounds, Probe
from large_shots import Taken
from make_scene import HEIGHT, LENS, SENSOR, WIDTH, prepare
from materials import Library
from mathutils import Matrix
from PIL import ExifTags, Image

HELD_OUT = "held_out/"
F_NUMBER, TIME, SPEED = 2.8, Fraction(1, 60), 100
FOCUSED_F = 1.4
"""f-number of photos focused on the foreground; it affects only the blur, not the exposure."""
QUALITY = 92


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the capture")
    parser.add_argument("--width", type=int, default=1280, help="of the photos, in pixels")
    parser.add_argument("--samples", type=int, default=8, help="Cycles samples per pixel")
    parser.add_argument("--threads", type=int, default=0, help="threads; 0 takes all")
    parser.add_argument("--drift", type=float, default=1.0, help="factor of the exposure's drift")
    parser.add_argument("--photos", default="images", help="folder of the developed photos")
    parser.add_argument("--most", type=int, help="render at most so many photos, then stop")
    parser.add_argument("--check", action="store_true", help="compare with Blender's own pictures")
    return parser.parse_args()


def plan(width: int) -> tuple[list[Taken], Bounds]:
    """All photos, with the held-out ones last, and the bounds of the boxed objects."""
    bounds = objects.bounds()
    slope = SENSOR / 2 / LENS
    probe = Probe((2 * math.atan(slope), 2 * math.atan(slope * HEIGHT / WIDTH)))
    shots = large_shots.large_capture(probe, bounds)
    return shots + large_shots.held_out(probe, bounds), bounds


def write_truth(path: Path, shots: list[Taken], bounds: Bounds, width: int) -> None:
    """Write cameras (camera to world, OpenCV axes), exposures, faults and object bounds as JSON."""
    photos = {}
    for shot in shots:
        matrix = shot.matrix()
        turn = [[round(r[0], 7), round(-r[1], 7), round(-r[2], 7)] for r in matrix.to_3x3()]
        photos[shot.name] = {
            "centre": [round(v, 6) for v in matrix.to_translation()],
            "rotation": turn,
            "stops": round(shot.stops, 4),
            "blurred": any((*shot.slide, *shot.swing)),
            "focus": shot.focus,
        }
    truth = {
        "frame": "Blender world: z up, metres",
        "width": width,
        "height": round(width * HEIGHT / WIDTH),
        "focal": LENS / SENSOR * width,
        "objects": {name: {"min": low, "max": high} for name, (low, high) in bounds.items()},
        "photos": photos,
    }
    path.write_text(json.dumps(truth, indent=1) + "\n")


def take(shot: Taken, camera: bpy.types.Object, path: Path) -> None:
    """Render what the sensor sees, as EXR."""
    scene = bpy.context.scene
    render, settings = scene.render, scene.render.image_settings
    settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR", "16", "ZIP"
    render.use_motion_blur = any((*shot.slide, *shot.swing))
    camera.animation_data_clear()
    if render.use_motion_blur:
        render.motion_blur_shutter, render.motion_blur_position = 1.0, "CENTER"
        camera.rotation_mode = "QUATERNION"
        for frame, part in ((0, -1.0), (1, 0.0), (2, 1.0)):
            place(camera, shot.moved(part))
            camera.keyframe_insert("location", frame=frame)
            camera.keyframe_insert("rotation_quaternion", frame=frame)
        scene.frame_set(1)
    else:
        camera.matrix_world = shot.matrix()
    lens = camera.data.dof
    lens.use_dof = shot.focus is not None
    if shot.focus is not None:
        lens.focus_distance, lens.aperture_fstop = shot.focus, FOCUSED_F
    partial = path.with_name(f"part-{path.name}")
    path.parent.mkdir(parents=True, exist_ok=True)
    render.filepath = str(partial)
    bpy.ops.render.render(write_still=True)
    partial.replace(path)


def place(camera: bpy.types.Object, matrix: Matrix) -> None:
    """Place the camera by location and rotation, which keyframes store."""
    camera.location, camera.rotation_quaternion = matrix.to_translation(), matrix.to_quaternion()


def sensor(path: Path) -> np.ndarray:
    """(H, W, 3) linear light of a rendered photo."""
    picture = bpy.data.images.load(str(path))
    picture.colorspace_settings.name = "Linear Rec.709"
    width, height = picture.size
    pixels = np.empty(width * height * 4, np.float32)
    picture.pixels.foreach_get(pixels)
    bpy.data.images.remove(picture)
    return pixels.reshape(height, width, 4)[::-1, :, :3]


def developed(light: np.ndarray, stops: float) -> Image.Image:
    """Develop light as a camera with this exposure does; bright light is clipped."""
    exposed = np.clip(light * 2.0**stops, 0.0, 1.0)
    curve = np.linspace(0, 1, 4097)
    return Image.fromarray((np.interp(exposed, linear(curve), curve) * 255 + 0.5).astype(np.uint8))


def exif(stops: float) -> Image.Exif:
    """The camera's EXIF: whole stops by the ISO value, the rest by the exposure time."""
    whole = math.floor(stops)
    data = Image.Exif()
    tags = data.get_ifd(ExifTags.IFD.Exif)
    tags[ExifTags.Base.ExposureTime] = float(TIME) * 2.0 ** (stops - whole)
    tags[ExifTags.Base.FNumber] = F_NUMBER
    tags[ExifTags.Base.ISOSpeedRatings] = round(4 * SPEED * 2.0**whole)
    return data


def develop(args: argparse.Namespace, shots: list[Taken]) -> None:
    """Develop all rendered photos; held-out ones become PNG files."""
    middle = float(np.median([s.stops for s in shots if not s.name.startswith(HELD_OUT)]))
    for shot in shots:
        source = (args.out / "linear" / shot.name).with_suffix(".exr")
        if not source.exists():
            continue
        light = sensor(source)
        if shot.name.startswith(HELD_OUT):
            name = Path(shot.name.removeprefix(HELD_OUT)).with_suffix(".png")
            target = args.out / f"{args.photos}_held_out" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            developed(light, middle).save(target)
        else:
            target = args.out / args.photos / shot.name
            target.parent.mkdir(parents=True, exist_ok=True)
            # Scale the drift around the middle, so that the held-out views suit any drift.
            stops = middle + args.drift * (shot.stops - middle)
            developed(light, stops).save(target, quality=QUALITY, exif=exif(stops))


def check(shots: list[Taken], camera: bpy.types.Object, out: Path) -> None:
    """Compare photos without faults with Blender's own renders."""
    worst = 0
    settings = bpy.context.scene.render.image_settings
    for shot in [shot for shot in shots if shot.plain][:3]:
        source, picture = (out / "check" / f"picture{ending}" for ending in (".exr", ".png"))
        take(shot, camera, source)
        settings.file_format, settings.color_depth = "PNG", "8"
        bpy.context.scene.render.filepath = str(picture)
        bpy.ops.render.render(write_still=True)
        ours = np.asarray(developed(sensor(source), 0.0), int)
        theirs = np.asarray(Image.open(picture).convert("RGB"), int)
        worst = max(worst, int(np.abs(ours - theirs).max()))
    print(f"largest difference to Blender's own pictures: {worst} of 255")


def main() -> None:
    """Build, plan, render, develop."""
    args = arguments()
    camera = prepare(args.samples, QUALITY, args.threads)
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y = args.width, round(args.width * HEIGHT / WIDTH)
    library = Library()
    room.build_room(library)
    objects.build_objects(library)
    shots, bounds = plan(args.width)
    print(f"{len(shots)} places", flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    write_truth(args.out / "truth.json", shots, bounds, args.width)
    if args.check:
        check(shots, camera, args.out)
        return
    mixed = [shots[k] for k in np.random.default_rng(0).permutation(len(shots))]
    # In random order, so that part of the photos is a small capture of the whole room.
    left = [s for s in mixed if not (args.out / "linear" / s.name).with_suffix(".exr").exists()]
    for number, shot in enumerate(left[: args.most], 1):
        begun = time.time()
        take(shot, camera, (args.out / "linear" / shot.name).with_suffix(".exr"))
        print(f"{number}/{len(left)} {shot.name}: {time.time() - begun:.1f} s", flush=True)
    develop(args, shots)


if __name__ == "__main__":
    main()
