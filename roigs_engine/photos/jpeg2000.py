"""JPEG 2000: the boxes of a file, and the header of a codestream (ISO/IEC 15444-1)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

START = b"\xff\x4f\xff\x51"
"""How a codestream begins."""
STARTS = (START, b"\0\0\0\x0cjP  \r\n\x87\n")
"""How a file begins (I.5.1)."""
MOST_BOXES = 4096
SIZE = 38
"""Bytes after `START`, up to and including the number of channels (A.5.1)."""
MOST_TILES = 1 << 14
"""Each tile of any size takes 12 kB during decoding."""


def boxes(file: BinaryIO, at: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield the boxes in a part of a file: kind, and start and end of the data (I.4).

    ValueError: there are far too many.
    """
    for _ in range(MOST_BOXES):
        if at + 8 > end:
            return
        file.seek(at)
        length, kind = struct.unpack(">I4s", file.read(8))
        start = at + 8
        if length == 1:
            (length,) = struct.unpack(">Q", file.read(8))
            start += 8
        stop = end if length == 0 else at + length
        if not start <= stop <= end:
            return
        yield kind, start, stop
        at = stop
    raise ValueError(f"a JPEG 2000 of more than {MOST_BOXES:,} boxes")


def picture_of(data: bytes, at: int) -> tuple[int, int, int]:
    """Width, height and channels of a codestream; `at` is the offset after its `START`.

    ValueError: it has too many tiles. struct.error: it is cut off.
    """
    right, low, left, top, wide, high, x, y, count = struct.unpack_from(">4x8IH", data, at)
    tiles = -(-(right - x) // max(wide, 1)) * -(-(low - y) // max(high, 1))
    if tiles > MOST_TILES:
        raise ValueError(f"a JPEG 2000 of {tiles:,} tiles")
    return right - left, low - top, count


def check_tiles(file: BinaryIO) -> None:
    """Raise as `picture_of` if a file has too many tiles or is cut off."""
    end, places = file.seek(0, 2), [0]
    places += [start for kind, start, _ in boxes(file, 0, end) if kind == b"jp2c"]
    for place in places:
        file.seek(place)
        if (head := file.read(len(START) + SIZE)).startswith(START):
            picture_of(head, len(START))
