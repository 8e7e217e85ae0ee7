"""Requests for compositing pictures, and their answers (docs/files.md)."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

REQUEST = ".json"
COLOUR, DEPTH, INDEX, SHARE = ".png", ".tif", "-index.tif", "-share.tif"
RANKS = 3
"""Number of objects with the largest shares in a pixel that an answer lists."""


def is_request(record: object) -> bool:
    """Whether a JSON value has the keys of a request."""
    keys = record.keys() if isinstance(record, dict) else set()
    return "out" in keys and ("samples" in keys or {"camera", "models"} <= keys)


def colour_file(out: Path) -> Path:
    """The picture's file, for a request's `out`."""
    return out.with_name(out.name + COLOUR)


def depth_file(out: Path) -> Path:
    """The depth's file, for a request's `out`; written before the picture."""
    return out.with_name(out.name + DEPTH)


def index_file(out: Path) -> Path:
    """The file with the indices of the objects with the largest shares in a pixel, for mattes."""
    return out.with_name(out.name + INDEX)


def share_file(out: Path) -> Path:
    """The file with these objects' shares of the pixel, from 0 to 1, for mattes."""
    return out.with_name(out.name + SHARE)


def write_nothing(out: Path, width: int, height: int, *, mattes: bool = False) -> None:
    """Write an answer without any Gaussians: a transparent PNG of the picture's size for each file.

    A missing file is black in some Blenders, and one of another size would crop the render.
    """
    nothing = png(bytes((1 + 4 * width) * height), width, height)
    more = (index_file(out), share_file(out)) if mattes else ()
    for file in (depth_file(out), colour_file(out), *more):
        file.write_bytes(nothing)


def tiff(values: NDArray[np.float32]) -> bytes:
    """A TIFF of (H, W) or (H, W, 3) 32-bit numbers without compression, in one strip."""
    height, width, channels = *values.shape[:2], values.size // (values.shape[0] * values.shape[1])
    data = values.astype("<f4").tobytes()
    short, long = 3, 4
    tags = [  # in the order of their numbers (TIFF 6.0)
        (256, long, [width]),
        (257, long, [height]),
        (258, short, [32] * channels),
        (259, short, [1]),  # not compressed
        (262, short, [1 if channels == 1 else 2]),  # grey or red, green, blue
        (273, long, [0]),  # start of the strip; set below
        (277, short, [channels]),
        (278, long, [height]),
        (279, long, [len(data)]),
        (339, short, [3] * channels),  # floating point
    ]
    begin = 8 + 2 + 12 * len(tags) + 4
    entries, more = b"", b""
    start = begin + sum(2 * len(v) for _, kind, v in tags if kind == short and len(v) > 2)
    for tag, kind, numbers in tags:
        numbers = [start] if tag == 273 else numbers
        packed = struct.pack(f"<{len(numbers)}{'H' if kind == short else 'I'}", *numbers)
        if len(packed) > 4:
            packed, more = struct.pack("<I", begin + len(more)), more + packed
        entries += struct.pack("<HHI", tag, kind, len(numbers)) + packed.ljust(4, b"\0")
    return b"II*\0\x08\0\0\0" + struct.pack("<H", len(tags)) + entries + bytes(4) + more + data


def png(rows: bytes, width: int, height: int) -> bytes:
    """An 8-bit RGBA PNG, uncompressed: it is read immediately, and compressing takes longer.

    Each row begins with a byte 0: no filter.
    """
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)  # 8-bit RGBA
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows, 0)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
