"""The size of a photo from the first bytes of its file, and its wholeness, without decoding it.

JPEG and PNG, which nearly all photos are, are read here: looking at a scene needs no Pillow.
Where Pillow opens a photo, it is told which kinds there may be: left to itself it looks at the
content alone, and would start Ghostscript for an EPS file that is called 'photo.jpg'.
"""

from __future__ import annotations

import os
import struct
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from ..errors import SceneError

if TYPE_CHECKING:
    from PIL.Image import Image

PNG = b"\x89PNG\r\n\x1a\n"
# JPEG markers: those that hold the frame's size, and those that have no length.
FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
BARE = {0x01, *range(0xD0, 0xD8)}
FORMATS = ("JPEG", "PNG", "TIFF", "BMP", "WEBP", "JPEG2000", "PPM")  # as Pillow calls them
PNG_END, JPEG_END = b"IEND", b"\xff\xd9"
TAIL = 1 << 16  # bytes in which they are looked for
# A larger photo is a damaged header or a trap: the largest cameras of today have 150 megapixels,
# and Pillow refuses what has more than 179.
MAX_PIXELS = 178_000_000
# What Pillow thinks of a photo's metadata is nothing that a person could act on.
warnings.filterwarnings("ignore", module=r"PIL\.")


class PhotoError(SceneError):
    """One photo is missing, damaged or of a kind that cannot be decoded."""


def photo_size(path: Path) -> tuple[int, int] | None:
    """(width, height) from the file's header, without its orientation tag.

    None: neither JPEG nor PNG, and Pillow, which reads the other kinds, is not installed.

    Raises:
        PhotoError: not a readable image file.
    """
    try:
        with open(path, "rb") as file:
            start = file.read(24)
            if start.startswith(PNG):
                width, height = struct.unpack(">II", start[16:])
            elif start.startswith(b"\xff\xd8"):
                width, height = _jpeg_size(file)
            else:
                return _usable(path, _size_by_pillow(path))
    except (OSError, ValueError, struct.error) as error:
        raise unreadable(path, error) from error
    return _usable(path, (width, height))


def check_complete(path: Path) -> None:
    """Nothing, where the file ends as a JPEG or PNG does or is of another kind.

    Where a JPEG's end mark is far from the file's end, as before a film that a telephone has put
    there, Pillow decides, if it is installed.

    Raises:
        PhotoError: the file was cut off.
    """
    try:
        with open(path, "rb") as file:
            start = file.read(len(PNG))
            file.seek(max(0, file.seek(0, os.SEEK_END) - TAIL))
            tail = file.read()
    except OSError as error:
        raise unreadable(path, error) from error
    mark = PNG_END if start == PNG else JPEG_END if start.startswith(b"\xff\xd8") else b""
    if mark in tail:
        return
    try:
        with open_photo(path) as photo:
            photo.load()
    except (ImportError, MemoryError):
        return  # nothing is known against it
    except Exception as error:  # Pillow's readers raise nearly anything on damaged files
        raise unreadable(path, error) from error


def open_photo(path: Path) -> Image:
    """The photo, opened by Pillow; whatever that raises on damaged files, its kinds are many."""
    from PIL import Image

    return Image.open(path, formats=FORMATS)


def _usable(path: Path, size: tuple[int, int] | None) -> tuple[int, int] | None:
    """The size; PhotoError when no photo has it."""
    if size is not None and not 0 < size[0] * size[1] <= MAX_PIXELS:
        raise unreadable(path, ValueError(f"it claims to have {size[0]} x {size[1]} pixels"))
    return size


def unreadable(path: Path, error: Exception) -> PhotoError:
    """The error for a photo that cannot be opened or decoded."""
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return PhotoError(
        f"Cannot read photo {path} ({reason}).", "Restore the file, or take it out of the model."
    )


def _jpeg_size(file: BinaryIO) -> tuple[int, int]:
    """Walk the segments to the frame header; ValueError or struct.error when there is none."""
    file.seek(2)
    while True:
        (lead, marker) = struct.unpack(">BB", file.read(2))
        if lead != 0xFF:
            raise ValueError("a damaged JPEG header")
        while marker == 0xFF:  # padding
            (marker,) = file.read(1) or (0,)
        if marker in BARE:
            continue
        if marker in FRAMES:
            height, width = struct.unpack(">3xHH", file.read(7))
            return width, height
        if marker in (0xD9, 0xDA):  # the pixels, or the end
            raise ValueError("a JPEG without a frame header")
        (length,) = struct.unpack(">H", file.read(2))
        if length < 2:
            raise ValueError("a damaged JPEG header")
        file.seek(length - 2, 1)


def _size_by_pillow(path: Path) -> tuple[int, int] | None:
    try:
        with open_photo(path) as photo:
            return photo.size
    except ImportError:
        return None
    except Exception as error:  # Pillow's readers raise nearly anything on damaged files
        raise unreadable(path, error) from error
