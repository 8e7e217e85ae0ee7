"""Requests for pictures for compositing (`render-frames`), and the files that answer them.

A request is a JSON file, written in one go (docs/files.md):

    {"camera": {...a camera of a camera path...}, "out": "/tmp/frames/splats0001",
     "models": [{"ply": "/runs/pot/result.ply", "matrix": [[...4], [...4], [...4], [...4]]}]}

`matrix` leads from the model's own world to the camera's; any affine one. The answer is a PNG with
sRGB colours and transparency, and a TIFF with the depth along the camera's axis in world units. The
request is deleted when it is answered, or refused with a warning.
"""

from __future__ import annotations

import base64
from pathlib import Path

REQUEST = ".json"
COLOUR, DEPTH = ".png", ".tif"
NOTHING = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAAC0lEQVR42mNgAAIAAAUAAen63NgAAAAASUVORK5CYII="
)
"""A picture of one pixel, transparent."""


def colour_file(out: Path) -> Path:
    """The picture of a request's `out`."""
    return out.with_name(out.name + COLOUR)


def depth_file(out: Path) -> Path:
    """The depth of a request's `out`; written before the picture."""
    return out.with_name(out.name + DEPTH)


def write_nothing(out: Path) -> None:
    """Write an answer without any Gaussians: some Blenders show a missing file as black."""
    for file in (depth_file(out), colour_file(out)):
        file.write_bytes(NOTHING)
