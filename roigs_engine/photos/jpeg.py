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
"""Most bytes of a JPEG for each pixel; for headers and an appended film."""
MOST_SCANS = 100  # scans of a JPEG, each of which may change all pixels; usual files have up to 20


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


def jpeg_segments(file: BinaryIO) -> Iterator[int]:
    """Yield the headers' markers, with `file` at the segment's length, up to the image data."""
    file.seek(2)
    while True:
        (lead, marker) = struct.unpack(">BB", file.read(2))
        if lead != 0xFF:
            raise ValueError("a damaged JPEG header")
        while marker == 0xFF:  # padding
            (marker,) = file.read(1) or (0,)
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
