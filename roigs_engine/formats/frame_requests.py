"""Requests for pictures for compositing, and the files that answer them (docs/files.md)."""

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
