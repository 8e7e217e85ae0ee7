# SPDX-License-Identifier: GPL-3.0-or-later
"""Film a walk around the table of the demo room: `python demo/video.py --out walk.mp4`.

The hand is not steady, the walk begins and ends with a rest, and it is faster in between, so that
some frames are alike and some are blurred, as in a real video. The frames are kept in a folder
beside the video, and the same command resumes. Needs Python 3.11 and
`pip install bpy==4.5.15 av`.
"""

from __future__ import annotations

import argparse
import math
import time
from fractions import Fraction
from pathlib import Path

import bpy
import cameras
import make_scene
import objects
import room
from mathutils import Vector

HEIGHT = 424  # encoders want multiples of 8
RATE, SECONDS, REST = 8, 20, 1.5
RADIUS, EYE = 1.15, 1.5  # metres from the vase, and above the floor
SHUTTER = 0.25  # of the time between frames


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="the video, such as walk.mp4")
    parser.add_argument("--samples", type=int, default=4, help="Cycles samples per pixel")
    parser.add_argument("--threads", type=int, default=0, help="threads; 0 takes all")
    return parser.parse_args()


def shot(seconds: float, vase: Vector) -> cameras.Shot:
    """The camera at a time of the video: it circles the vase, which is in the picture's middle."""
    walked = (seconds - REST) / (SECONDS - 2 * REST)
    walked = min(1.0, max(0.0, walked))
    ease = walked * walked * (3 - 2 * walked)
    angle = 2 * math.pi * (0.7 * walked + 0.3 * ease) - 0.6
    near = RADIUS + 0.15 * math.sin(3 * angle)
    moving = 1.0 if 0 < walked < 1 else 0.15
    sway = [moving * 0.02 * math.sin(f * seconds + p) for f, p in ((3.1, 0), (4.3, 1), (7.7, 2))]
    eye = vase + Vector((near * math.cos(angle), near * math.sin(angle), 0)) + Vector(sway)
    eye.z = EYE + 0.2 * math.sin(angle) + sway[2]
    shake = [moving * 0.04 * math.sin(f * seconds + p) for f, p in ((5.3, 1), (6.1, 2), (9.1, 0))]
    return cameras.Shot("", eye, vase + Vector(shake))


def render(folder: Path, args: argparse.Namespace) -> list[Path]:
    """Render the frames as PNG files; existing ones are kept."""
    camera = make_scene.prepare(args.samples, 100, args.threads)
    render = bpy.context.scene.render
    render.resolution_y = HEIGHT
    render.image_settings.file_format = "PNG"
    render.use_motion_blur, render.motion_blur_shutter = True, SHUTTER
    materials = room.Library()
    room.build_room(materials)
    objects.build_objects(materials)
    low, high = (Vector(corner) for corner in objects.bounds()["vase"])
    paths = [folder / f"{number:04d}.png" for number in range(RATE * SECONDS)]
    camera.rotation_mode = "QUATERNION"
    for number in range(-1, len(paths) + 1):
        matrix = shot(number / RATE, (low + high) / 2).matrix()
        camera.location, camera.rotation_quaternion = (
            matrix.to_translation(),
            matrix.to_quaternion(),
        )
        camera.keyframe_insert("location", frame=number + 1)
        camera.keyframe_insert("rotation_quaternion", frame=number + 1)
    for number, path in enumerate(paths):
        if path.exists():
            continue
        bpy.context.scene.frame_set(number + 1)
        partial = path.with_suffix(".part.png")
        render.filepath = str(partial)
        begun = time.time()
        bpy.ops.render.render(write_still=True)
        partial.replace(path)
        print(f"{path.name}: {time.time() - begun:.1f} s", flush=True)
    return paths


def encode(paths: list[Path], out: Path) -> None:
    """Encode the frames as H.264, as phones do."""
    import av
    from PIL import Image

    with av.open(str(out), "w") as video:
        stream = video.add_stream("libx264", rate=Fraction(RATE), options={"crf": "20"})
        stream.width, stream.height, stream.pix_fmt = make_scene.WIDTH, HEIGHT, "yuv420p"
        for path in paths:
            frame = av.VideoFrame.from_image(Image.open(path).convert("RGB"))
            video.mux(stream.encode(frame))
        video.mux(stream.encode(None))


def main() -> None:
    """Render, then encode."""
    args = arguments()
    folder = args.out.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    encode(render(folder, args), args.out)


if __name__ == "__main__":
    main()
