"""Rotates photos by their EXIF tag, for models of software that applies it.

COLMAP ignores the tag, and so does this engine for its models: `turn` is then `AS_STORED`. Other
software applies the tag first. `colmap.rotations` finds out which rule a model follows.

A turn is the tag's value (Exif 3.0, 4.6.4, Orientation): the operation that the stored pixels need.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..formats.files import regular
from .headers import ORIENTATION, TURN, PhotoError, exif_of, open_photo
from .jpeg import EXIF, jpeg_exif
from .png import EXIF_CHUNK, PNG, png_chunk

AS_STORED = 1
SIDEWAYS = range(5, 9)  # turns that swap width and height
TIFF_SHORT = 3
Values = TypeVar("Values", NDArray[np.uint8], NDArray[np.bool_])


def rotation_tag(path: Path) -> int:
    """The turn in a photo's EXIF data; `AS_STORED` if there is none, or they are damaged.

    JPEG and PNG headers are read here, since reading cameras does not need Pillow.
    """
    tag = AS_STORED
    damage = (OSError, ValueError, struct.error, PhotoError, MemoryError)
    with suppress(*damage), open(path, "rb", opener=regular) as file:
        start = file.read(8)
        if start.startswith(b"\xff\xd8"):
            tag = _of_exif(jpeg_exif(file))
        elif start == PNG:
            tag = _of_exif(png_chunk(file, EXIF_CHUNK).removeprefix(EXIF))  # may follow the pixels
        elif start[:2] in (b"II", b"MM") or start.startswith(b"RIFF"):
            with open_photo(path) as photo:
                tag = int(photo.info.get(TURN) or exif_of(photo).get(ORIENTATION, AS_STORED))
    return tag if tag in range(1, 9) else AS_STORED


def turned_size(size: tuple[int, int], turn: int) -> tuple[int, int]:
    """The size (width, height) after a turn; also converts back."""
    return (size[1], size[0]) if turn in SIDEWAYS else size


def turned(pixels: Values, turn: int) -> Values:
    """Apply a turn to pixels (H, W, ...)."""
    if turn in SIDEWAYS:
        pixels = pixels.swapaxes(0, 1)
    if turn in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if turn in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return np.ascontiguousarray(pixels)


def _of_exif(data: bytes) -> int:
    """The tag in EXIF data, which are a TIFF file; struct.error and ValueError: damaged."""
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None:
        raise ValueError("no TIFF header")
    (at,) = struct.unpack_from(order + "I", data, 4)
    (entries,) = struct.unpack_from(order + "H", data, at)
    for entry in range(entries):
        tag, kind, value = struct.unpack_from(order + "HH4xH", data, at + 2 + 12 * entry)
        if tag == ORIENTATION and kind == TIFF_SHORT:
            return int(value)
    return AS_STORED
