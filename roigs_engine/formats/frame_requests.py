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
    nothing = png(bytes((1 + 4 * width) * height), width, height)
    for file in (depth_file(out), colour_file(out)):
        file.write_bytes(nothing)


def png(rows: bytes, width: int, height: int) -> bytes:
    """An 8-bit RGBA PNG without compression: it is read at once, and compressing takes longer.

    Each row begins with a byte 0: no filter.
    """
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)  # 8-bit RGBA
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows, 0)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
