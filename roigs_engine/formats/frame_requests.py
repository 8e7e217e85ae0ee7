"""Requests for pictures for compositing (`render-frames`), and the files that answer them.

A request is a JSON file, written in one go (docs/files.md):

    {"camera": {...a camera of a camera path...}, "out": "/tmp/frames/splats0001",
     "models": [{"ply": "/runs/pot/result.ply", "matrix": [[...4], [...4], [...4], [...4]],
                 "gains": [1, 1, 1], "density": 1}]}

`matrix` leads from the model's own world to the camera's; any affine one. `gains` multiply red,
green and blue; `density`, above 0 and at most 1, is how much of the model is there. Both may be
missing. Relative paths start at the request's folder. The answer is a PNG with sRGB colours and
transparency, and a TIFF with the depth along the camera's axis in world units. The request is
deleted when it is answered, or refused with a warning.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

REQUEST = ".json"
COLOUR, DEPTH = ".png", ".tif"


def colour_file(out: Path) -> Path:
    """The picture of a request's `out`."""
    return out.with_name(out.name + COLOUR)


def depth_file(out: Path) -> Path:
    """The depth of a request's `out`; written before the picture."""
    return out.with_name(out.name + DEPTH)


def write_nothing(out: Path, width: int, height: int) -> None:
    """Write an answer without any Gaussians: a transparent PNG of the picture's size, twice.

    A missing file is black in some Blenders, and one of another size would crop the render.
    """
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)  # 8-bit RGBA
    rows = zlib.compress(bytes((1 + 4 * width) * height), 1)
    parts = ((b"IHDR", header), (b"IDAT", rows), (b"IEND", b""))
    png = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
    for file in (depth_file(out), colour_file(out)):
        file.write_bytes(png)
