"""Photos of more than 8 bits a channel at their full depth, of which Pillow keeps 8 for colours."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile

from .colours import packing
from .headers import open_photo
from .profiles import PART, Deep, parts_of
from .tiff import TiffPhoto

COLOUR = re.compile(r"(RGB|RGBA|RGBX|RGBa);16([BLN])$")
OTHER = {"B": "L", "L": "B", "N": "B" if sys.byteorder == "little" else "L"}


def deep_values(photo: Image.Image) -> Deep | None:
    """(H, W, 1 or 3) uint16 grey or RGB of an opened photo, not decoded yet.

    None: it has 8 bits, inks, L*a*b*, or more bits that its library does not hand on.
    """
    if isinstance(photo, TiffPhoto):
        return photo.deep()
    stored = packing(photo)
    if photo.mode == "F":
        values = np.nan_to_num(np.array(photo), copy=False).clip(0, 1)
        return np.asarray((values * 65535).round().astype(np.uint16)[..., None])
    if photo.mode.startswith("I"):
        return _grey(np.asarray(photo), stored)[..., None]
    first = stored.split(" ", 1)[0]
    if first == "LA;16B":  # two bytes each of grey and alpha
        with open_photo(Path(getattr(photo, "filename", ""))) as again:  # not turned by its tag
            _read_as(again, "RGBA")
            high, low = (np.asarray(again.getchannel(k)) for k in (0, 1))
        return np.asarray(high.astype(np.uint16) << 8 | low)[..., None]
    found = COLOUR.match(first)
    if found is None:
        return None
    channels, order = found.groups()
    alike = channels.replace("a", "A")
    values = _halves(
        photo, *(f"{alike};16{half}" for half in (order, OTHER[order])), alpha=alike != channels
    )
    if alike != channels:  # multiplied by alpha
        for part in parts_of(values):
            alpha = np.maximum(part[..., 3:], 1).astype(np.float32)
            part[:] = (part * (65535 / alpha)).round().clip(0, 65535)
    return values[..., :3]


def _halves(photo: Image.Image, high: str, low: str, *, alpha: bool) -> Deep:
    """(H, W, 3 or 4) of a photo's file, by the packings with which Pillow reads its bytes.

    In parts: a large photo has twice the bytes of Pillow's picture.
    """
    values: Deep = np.empty(0, np.uint16)
    for shift, packed in ((8, high), (0, low)):
        with open_photo(Path(getattr(photo, "filename", ""))) as again:  # not turned by its tag
            _read_as(again, packed)
            if shift:
                values = np.zeros((again.height, again.width, 4 if alpha else 3), np.uint16)
            rows = max(1, PART // again.width)
            for top in range(0, again.height, rows):
                box = (0, top, again.width, min(top + rows, again.height))
                part = np.asarray(again.crop(box))[..., : values.shape[2]]
                values[top : top + rows] |= np.left_shift(part, shift, dtype=np.uint16)
    return values


def transparent(photo: Image.Image) -> NDArray[np.bool_] | None:
    """(H, W) the pixels of the one transparent colour of an opened PNG; None: it names none.

    Pillow compares it with values that it has scaled to 8 bits, as those of tRNS are not.
    """
    colour = photo.info.get("transparency")
    if photo.format != "PNG" or photo.mode == "P" or isinstance(colour, bytes) or colour is None:
        return None
    with Image.open(getattr(photo, "filename", "")) as fresh:  # the photo may be decoded already
        stored = packing(fresh)
        values: NDArray[Any] | None = deep_values(fresh)
        if values is None:
            values = np.atleast_3d(np.asarray(fresh.convert("L") if fresh.mode == "1" else fresh))
    if photo.mode == "1":
        colour = 255 if colour else 0
    elif photo.mode == "L" and (bits := re.search(r"L;(\d)", stored)):
        colour = colour * (255 // (2 ** int(bits[1]) - 1))
    return np.asarray((values == np.array(colour)).all(axis=2))


def _grey(values: NDArray[Any], stored: str) -> Deep:
    """(H, W) values of 12, 16 or 32 bits, as they are stored, in 16."""
    if re.search(r"I;32[BN]?\b", stored):  # unsigned; signed ones hold 16 bits in a wider type
        return (values.view(np.uint32) >> 16).astype(np.uint16)
    if "I;12" in stored:
        return (values.astype(np.uint32) * 65535 // 4095).astype(np.uint16)
    return np.asarray(values.clip(0, 65535).astype(np.uint16))


def _read_as(photo: Image.Image, packed: str) -> None:
    """Decode an opened photo, its bytes taken as another packing of as many bits."""
    assert isinstance(photo, ImageFile.ImageFile)
    photo.tile = [_packed(tile, packed) for tile in photo.tile]
    photo.load()


def _packed(tile: Any, packed: str) -> Any:
    args = (packed, *tile[3][1:]) if isinstance(tile[3], tuple) else packed
    return tile._replace(args=args) if hasattr(tile, "_replace") else (*tile[:3], args)  # Pillow 10
