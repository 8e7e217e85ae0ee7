"""Segments of JPEG files: the size of the photo, and the number of its scans."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO

# JPEG markers: those with the frame's size, and those without a length.
FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
PROGRESSIVE = {0xC2, 0xC6, 0xCA, 0xCE}
BARE = {0x01, *range(0xD0, 0xD8)}
JPEG_END, SCAN = b"\xff\xd9", b"\xff\xda"
PER_PIXEL, BESIDE = 8, 64 << 20
"""Bytes that a JPEG may have for each pixel, and besides: for headers, and a film behind it."""
MOST_SEGMENTS = 4096  # of the headers; Pillow takes microseconds for each, and for padding
APP1, EXIF = 0xE1, b"Exif\0\0"
MOST_SEGMENT, MOST_EXIF = 65_533, 1 << 20  # bytes; EXIF data may be in several segments
MOST_SCANS = 100  # of a JPEG; each may change all pixels. Usual files have up to 20


def jpeg_size(file: BinaryIO) -> tuple[int, int]:
    """(width, height) from the header of a JPEG; ValueError, struct.error: it is damaged."""
    if not any(marker in FRAMES for marker in jpeg_segments(file)):
        raise ValueError("a JPEG without a frame header")
    height, width = struct.unpack(">3xHH", file.read(7))
    return width, height


def check_scans(file: BinaryIO) -> None:
    """Raise ValueError if a JPEG has so many scans that decoding it would take minutes or hours.

    The file is read to the photo's end only if its first scan does not hold the whole photo.
    """
    most, width, height = BESIDE, 0, 0
    with suppress(ValueError, IndexError, struct.error):  # other code reports damage
        progressive, components = False, 0
        for marker in jpeg_segments(file):
            if marker in FRAMES:
                progressive = marker in PROGRESSIVE
                height, width, components = struct.unpack(">3xHHB", file.read(8))
                most = BESIDE + PER_PIXEL * width * height
        if not progressive and file.read(3)[-1] >= components:
            return
    data = file.read(most)
    cut_off = len(data) == most
    if not cut_off and data.count(SCAN) < MOST_SCANS:  # also in other parts of the file
        return
    at, scans = data.find(b"\xff"), 1
    while 0 <= at < len(data) - 3 and data[at + 1] != JPEG_END[1]:
        length = 1
        if data[at + 1] not in (0, 0xFF, *BARE):
            length = 2 + int.from_bytes(data[at + 2 : at + 4])
            scans += data[at + 1] == SCAN[1]
        at = data.find(b"\xff", at + length)
    if scans > MOST_SCANS:
        raise ValueError(f"a JPEG of {scans} scans")
    if cut_off and not 0 <= at < len(data) - 3:
        raise ValueError(f"a JPEG of more than {most >> 20} MB, for {width} x {height} pixels")


def jpeg_exif(file: BinaryIO) -> bytes:
    """The EXIF data of a JPEG, joined as Pillow does; empty: there are none.

    ValueError, struct.error: the headers are damaged, or far too long.
    """
    found = b""
    for marker in jpeg_segments(file):
        if marker == APP1:
            (length,) = struct.unpack(">H", file.read(2))
            data = file.read(max(length - 2, 0))
            found += data[len(EXIF) :] if data.startswith(EXIF) else b""
        if len(found) > MOST_EXIF:
            raise ValueError(f"its EXIF data have more than {MOST_EXIF >> 20} MB")
    return found


def jpeg_segments(file: BinaryIO) -> Iterator[int]:
    """Yield the headers' markers, with `file` at the segment's length, up to the image data.

    ValueError, struct.error: they are damaged, or far too many.
    """
    file.seek(2)
    for _ in range(MOST_SEGMENTS):
        (lead, marker) = struct.unpack(">BB", file.read(2))
        if lead != 0xFF:
            raise ValueError("a damaged JPEG header")
        if marker == 0xFF:  # padding
            file.seek(-1, 1)
            continue
        if marker in BARE:
            continue
        if marker in (0xD9, 0xDA):  # end of the file, or start of the pixels
            return
        at = file.tell()
        yield marker
        file.seek(at)
        (length,) = struct.unpack(">H", file.read(2))
        if length < 2:
            raise ValueError("a damaged JPEG header")
        file.seek(length - 2, 1)
    raise ValueError(f"a JPEG of more than {MOST_SEGMENTS:,} segments before its pixels")
