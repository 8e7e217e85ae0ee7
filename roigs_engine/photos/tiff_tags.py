"""Limits to the tags of a TIFF's pages and of EXIF data, which are TIFFs, too."""

from __future__ import annotations

import io
import struct
from contextlib import suppress
from typing import BinaryIO, NamedTuple

import numpy as np

MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
MOST_PAGES = 64
TYPE_BYTES = np.array([0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8])
"""Bytes of a value, by the number of its type (TIFF 6.0, section 2, and BigTIFF)."""
MOST_TAGS = 4096  # of a page
MOST_LOOKS = 1024  # lists of tags read: of pages, of pages below them, of EXIF data
MOST_PLACES = 1 << 22  # numbers in a page's lists: places of strips, tiles and pages below
MOST_NUMBERS = 1 << 18  # numbers of all other tags; a palette of 16 bits has three quarters of it
TEXT, RATIONAL = (1, 2, 7), (5, 10)  # types that Pillow reads as bytes; that take it the longest
LISTS, BELOW = (273, 279, 324, 325, 330), (330, 34665, 34853, 40965)  # BELOW: of other pages


def check_tags(file: BinaryIO) -> None:
    """Raise ValueError if the data of a page's tags overlap, or if there are far too many.

    Pillow and tifffile read all data, and 4,096 tags may share a gigabyte. Other damage, and files
    that are no TIFF, are left to these libraries.

    Args:
        file: TIFF or EXIF data. Its first pages and the pages below the first are checked.
    """
    head = file.read(16)
    order = {b"II": "<", b"MM": ">"}.get(head[:2], "")
    if head[:4] not in MAGIC:
        return
    big, size = head[2:4] in (b"+\0", b"\0+"), file.seek(0, io.SEEK_END)
    kind = _Kind(order, big, size, {})
    with suppress(struct.error):  # the data are cut off
        (at,) = struct.unpack_from(order + ("8xQ" if big else "4xI"), head)
        for page in range(MOST_PAGES):
            at = _check_directory(file, at, kind, 0 if page else 2) if at else 0


class _Kind(NamedTuple):
    """A TIFF's byte order, whether it is a BigTIFF, and its size in bytes.

    `looked`: the lists of tags that were checked, as (place, depth): lists may name one another.
    Each has the count of its numbers.
    """

    order: str
    big: bool
    size: int
    looked: dict[tuple[int, int], float]


def _check_directory(file: BinaryIO, at: int, kind: _Kind, depth: int) -> int:
    """Check the tags of the page at `at`; returns the place of the next page, 0 for none.

    `depth`: how many levels of pages below it are checked, too.
    """
    order, big, size, looked = kind
    if (at, depth) in looked:
        return 0
    looked[at, depth] = 0.0
    if len(looked) > MOST_LOOKS:
        raise ValueError(f"it has more than {MOST_LOOKS:,} lists of tags")
    width = 8 if big else 4
    file.seek(at)
    (count,) = struct.unpack(order + ("Q" if big else "H"), file.read(8 if big else 2))
    if count > MOST_TAGS:
        raise ValueError(f"a page has {count:,} tags")
    names = [("code", "u2"), ("type", "u2"), ("count", f"u{width}"), ("value", f"u{width}")]
    entry = np.dtype([(name, order + form) for name, form in names])
    data = file.read(count * entry.itemsize)
    following = file.read(width)
    entries = np.frombuffer(data, entry, len(data) // entry.itemsize)
    bytes_ = TYPE_BYTES[np.where(entries["type"] < len(TYPE_BYTES), entries["type"], 0)]
    lengths = bytes_ * entries["count"].astype(np.float64)
    read = (lengths > width) & (entries["value"].astype(np.float64) + lengths <= size)
    if lengths[read].sum() > size:
        raise ValueError("the data of its tags overlap")
    listed = read & np.isin(entries["code"], LISTS) & (bytes_ > 1)
    if entries["count"][listed].astype(np.float64).sum() > MOST_PLACES:
        raise ValueError("its pixels are in far too many parts")
    listed &= ~np.isin(entries["type"], RATIONAL)
    numbers = read & ~listed & ~np.isin(entries["type"], TEXT)
    looked[at, depth] = float(entries["count"][numbers].astype(np.float64).sum())
    if sum(looked.values()) > MOST_NUMBERS:
        raise ValueError("its tags have far too many numbers")
    for row in np.flatnonzero(np.isin(entries["code"], BELOW) & (depth > 0)):
        places = [int(entries["value"][row])]
        if read[row] and bytes_[row] in (4, 8):
            file.seek(places[0])
            form = f"{order}u{bytes_[row]}"
            places = np.frombuffer(file.read(int(lengths[row])), form).tolist()
        elif big and order == ">" and bytes_[row] == 4:
            places = [places[0] >> 32]
        for place in [*dict.fromkeys(places)][:MOST_PAGES]:
            with suppress(struct.error):
                _check_directory(file, place, kind, depth - 1)
    return int(struct.unpack(order + ("Q" if big else "I"), following)[0])
