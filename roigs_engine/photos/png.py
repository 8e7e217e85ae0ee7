"""Chunks of PNG files (PNG specification, section 5)."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from typing import BinaryIO

from .jpeg import MOST_EXIF

PNG = b"\x89PNG\r\n\x1a\n"
PNG_END, PIXELS, EXIF_CHUNK = b"IEND", b"IDAT", b"eXIf"
MOST_CHUNKS, LEAST_BYTES = 4096, 256
"""A PNG may have so many chunks, and another one for so many of its bytes: each takes time."""


def png_chunks(file: BinaryIO) -> Iterator[tuple[bytes, int]]:
    """Yield the kind and length of a PNG's chunks, with `file` at their data, up to the end.

    ValueError: there are far too many, or the EXIF data are far too long.
    """
    most = MOST_CHUNKS + file.seek(0, os.SEEK_END) // LEAST_BYTES
    at = len(PNG)
    for _ in range(most):
        file.seek(at)
        if len(head := file.read(8)) < 8:
            return
        length, kind = struct.unpack(">I4s", head)
        if kind == EXIF_CHUNK and length > MOST_EXIF:
            raise ValueError(f"its EXIF data have {length >> 20} MB")
        yield kind, length
        if kind == PNG_END:
            return
        at += 8 + length + 4  # the checksum too
    raise ValueError(f"a PNG of more than {most:,} chunks")


def png_chunk(file: BinaryIO, kind: bytes, end: bytes = PNG_END) -> bytes:
    """The data of a PNG's first chunk of a kind before a chunk `end`; empty: there is none."""
    for found, length in png_chunks(file):
        if found == kind:
            return file.read(length)
        if found == end:
            break
    return b""
