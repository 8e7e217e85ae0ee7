"""Family: videos of many containers and codecs, damaged; their frames become photos."""

from __future__ import annotations

import functools
import io
import random
import struct
from dataclasses import dataclass
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from roigs_engine.app.outputs import Result
from roigs_engine.context import Context
from roigs_engine.reconstruction.folder import Folder
from roigs_engine.reconstruction.video import take_frames
from roigs_engine.requests.declare import Request, option
from roigs_engine.requests.values import PATH
from tests.fuzz.cases import Case, Family, write
from tests.fuzz.damage import ODD_INTEGERS, bytes_damaged

INSTALLED = find_spec("av") is not None
SIZE = (96, 72)
FORMATS = (
    *(("mp4", "mp4", "mpeg4", "yuv420p"), ("mov", "mov", "mjpeg", "yuvj420p")),
    *(("mkv", "matroska", "ffv1", "yuv420p"), ("avi", "avi", "rawvideo", "bgr24")),
    *(("ts", "mpegts", "mpeg2video", "yuv420p"), ("mpg", "mpeg", "mpeg2video", "yuv420p")),
    *(("mov", "mov", "prores_ks", "yuv422p10le"), ("avi", "avi", "huffyuv", "yuv422p")),
    *(("mov", "mov", "png", "rgba"), ("mkv", "matroska", "mpeg4", "yuv420p")),
)
"""Endings, containers, codecs, and kinds of pixels, of which every FFmpeg has the encoders."""


@dataclass(frozen=True, kw_only=True)
class Frames(Request):
    """A video, and a folder that gets frames of it."""

    video: Path = option(PATH, "file", required=True, flags=())
    out: Path = option(PATH, "folder", required=True)


def take(request: Any, context: Context) -> Result:
    """The part of `reconstruct` before it looks for features, on a video."""
    folder = Folder(request.out)
    with folder.held(context.warn):
        for frame in take_frames(request.video, folder, 3, context).values():
            with Image.open(frame) as picture:
                picture.load()
    return Result()


@functools.cache
def film(container: str, codec: str, pixels: str) -> bytes:
    """A short pan along a wall; it has a title, and turns by a quarter in what can say so."""
    import av

    noise = np.random.default_rng(0).integers(0, 255, (20, 60), dtype=np.uint8)
    wall, file = np.asarray(Image.fromarray(noise).resize((600, 200))), io.BytesIO()
    with av.open(file, "w", format=container) as video:
        video.metadata["title"] = "a pan"
        stream: Any = video.add_stream(codec, rate=Fraction(10))
        stream.width, stream.height, stream.pix_fmt = *SIZE, pixels
        for left in range(0, 160, 8):
            picture = Image.fromarray(wall[: SIZE[1], left : left + SIZE[0]]).convert("RGB")
            video.mux(stream.encode(av.VideoFrame.from_image(picture).reformat(format=pixels)))
        video.mux(stream.encode(None))
    return file.getvalue()


def videos(dice: random.Random, folder: Path) -> Case:
    """A video with a few, or very many, damaged bytes, also one under the name of another kind."""
    ending, *kind = dice.choice(FORMATS)
    data = bytearray(film(*kind))
    match dice.randrange(6):
        case 0:
            del data[dice.randrange(len(data)) :]
        case 1:  # where containers have their records
            for _ in range(dice.choice((1, 2, 5))):
                place = dice.randrange(1500) if dice.random() < 0.5 else -dice.randrange(8, 1800)
                number = dice.choice(ODD_INTEGERS) % (1 << 32)
                at = place % len(data)
                data[at : at + 4] = struct.pack(dice.choice("<>") + "I", number)
        case 2:
            for _ in range(200):
                data[dice.randrange(len(data))] = dice.randrange(256)
        case 3:
            ending = dice.choice(FORMATS)[0]
        case 4:
            data = data.replace(b"a pan", dice.randbytes(5))
        case _:
            data = bytearray(bytes_damaged(dice, bytes(data), 8))
    path = write(folder / "in" / f"a.{ending}", bytes(data))
    return Case(["frames", str(path), "--out", str(folder / "out")])


FAMILIES: dict[str, tuple[Family, int]] = {"videos": (videos, 200)} if INSTALLED else {}
