"""Colour spaces of photos' files, and conversion to sRGB.

A file's colour space is the first of these that the file has:

- the ICC profile of a JPEG, PNG, TIFF, WebP, HEIC, JPEG 2000 or BMP;
- in a PNG, by its specification (third edition, 4.3): cICP, iCCP, sRGB, cHRM with gAMA;
- the code points of a HEIC (nclx, ITU-T H.273);
- Adobe RGB, if the EXIF data say so as cameras do (DCF 2.0: interoperability index R03).

Colours are converted relative to white, with black-point compensation, so colours within sRGB stay
exact. Perceptual conversion would change these, too, by tables that differ between profiles.
Colours outside sRGB are clipped. A profile that equals sRGB up to rounding changes nothing. Photos
of more than 8 bits are converted at full depth, except by profiles with tables.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageCms

from ..formats.files import regular
from .headers import CONVERTED, DAMAGED, exif_of, open_photo
from .jpeg2000 import boxes
from .png import PIXELS, png_chunk
from .profiles import (
    ADOBE_GAMMA,
    ADOBE_RGB,
    SRGB,
    Deep,
    Space,
    space_of_code,
    space_of_gamma,
    space_of_profile,
)

# EXIF tags: the photo's table, its colour space, the interoperability table, its index
EXIF_IFD, COLOUR_SPACE, INTEROPERABILITY_IFD, INDEX = 0x8769, 0xA001, 0xA005, 1
SAYS_SRGB, SAYS_ADOBE = 1, 2
GAMMA, GAMMA_TOLERANCE = 1 / 2.2, 0.05  # a PNG within these is sRGB, as in libpng
ROUNDING = 2  # of 255: profiles of sRGB differ by up to this
MOST_PROFILE = 8 << 20  # bytes; printers' profiles with tables have about 3 MB
LATTICE = 17  # values of each channel at which a profile is compared with sRGB
BLACK_POINT: Any = 0x2000  # flag of LittleCMS; Pillow 10.1 has no name for it
MODES = {"RGB ": "RGB", "GRAY": "L", "CMYK": "CMYK", "Lab ": "LAB"}
Conversion = Callable[[Image.Image], Image.Image]


class ProfileError(ValueError):
    """A profile is damaged, or of another kind than the photo."""


@dataclass(frozen=True)
class Colours:
    """A photo's colour space or ICC profile (empty: sRGB), and whether that is damaged."""

    profile: bytes | Space = b""
    damaged: bool = False

    def __str__(self) -> str:
        return DAMAGED if self.damaged else CONVERTED if self.profile else ""


def colours_of(photo: Image.Image) -> Colours:
    """The colour space of an opened photo, before it is decoded."""
    try:
        profile = _profile(photo)
        if profile and _conversion(profile, kind_of(photo)) is None:
            return Colours()
        return Colours(profile=profile)
    except MemoryError:
        raise
    except Exception:  # damaged profiles, chunks and boxes
        return Colours(damaged=True)


def colours_in_words(path: Path) -> str:
    """CONVERTED, DAMAGED or "" (sRGB) of a photo's file; "" also if it cannot be opened."""
    with suppress(Exception), open_photo(path) as photo:  # other code reports the photo
        return str(colours_of(photo))
    return ""


def to_srgb(pixels: Image.Image, colours: Colours) -> Image.Image:
    """Convert a photo's decoded pixels (L, RGB, CMYK or LAB) to sRGB."""
    convert = _conversion(colours.profile, pixels.mode) if colours.profile else None
    if convert is None:
        return pixels if pixels.mode == "RGB" else pixels.convert("RGB")
    converted = convert(pixels)
    converted.info = {}  # this removes the old profile
    return converted


def deep_to_srgb(values: Deep, colours: Colours) -> Image.Image | None:
    """Convert values (grey or RGB) to sRGB at full depth; None: the profile has tables."""
    space: bytes | Space | None = colours.profile
    with suppress(struct.error, ValueError, IndexError, ArithmeticError):  # LittleCMS may read it
        if isinstance(space, bytes):
            space = space_of_profile(space)
        return Image.fromarray(space.to_srgb(values)) if space else None
    return None


def say_srgb(exif: Image.Exif) -> None:
    """Set the colour space in a photo's EXIF data to sRGB."""
    exif.get_ifd(EXIF_IFD)[COLOUR_SPACE] = SAYS_SRGB


def kind_of(photo: Image.Image) -> str:
    """The mode for converting the pixels of an opened photo, before it is decoded."""
    if photo.mode in ("CMYK", "LAB"):
        return photo.mode
    grey = photo.mode in ("1", "L", "LA", "La", "F") or photo.mode.startswith("I")
    return "L" if grey or packing(photo).startswith("LA;16") else "RGB"


def packing(photo: Image.Image) -> str:
    """The packing of values in a file, in Pillow's notation: "RGB;16B" for 16 bits a channel.

    Empty once the photo is decoded.
    """
    return " ".join(
        str(tile[3][0] if tile[3] and isinstance(tile[3], tuple) else tile[3])
        for tile in getattr(photo, "tile", ())
    )


@lru_cache(maxsize=32)
def _conversion(profile: bytes | Space, mode: str) -> Conversion | None:
    """The conversion of pixels of that mode to sRGB; None: they are sRGB.

    Raises:
        ProfileError: the profile is damaged, or not for such pixels.
    """
    convert = _by_space(profile, mode) if isinstance(profile, Space) else _by_icc(profile, mode)
    return None if mode in ("RGB", "L") and _changes_nothing(convert, mode) else convert


def _by_space(space: Space, mode: str) -> Conversion:
    if mode not in ("RGB", "L"):
        raise ProfileError("a space of RGB")
    return lambda pixels: Image.fromarray(space.to_srgb(np.atleast_3d(np.array(pixels))))


def _by_icc(profile: bytes, mode: str) -> Conversion:
    """The conversion by LittleCMS."""
    try:
        opened = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        own = MODES.get(opened.profile.xcolor_space, "")
        if own != mode and not (own == "RGB" and mode == "L"):
            raise ProfileError(f"a profile of {opened.profile.xcolor_space.strip()}")
        transform = ImageCms.buildTransform(
            opened,
            ImageCms.createProfile("sRGB"),
            own,
            "RGB",
            ImageCms.Intent.RELATIVE_COLORIMETRIC,
            BLACK_POINT,
        )
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError) as error:
        raise ProfileError(str(error)) from error
    return lambda pixels: transform.apply(pixels if pixels.mode == own else pixels.convert(own))


def _changes_nothing(convert: Conversion, mode: str) -> bool:
    """Whether a conversion to sRGB changes colours by no more than rounding."""
    if mode == "L":
        given = Image.fromarray(np.arange(256, dtype=np.uint8)[None])
    else:
        values = np.linspace(0, 255, LATTICE).round().astype(np.uint8)
        lattice = np.stack(np.meshgrid(values, values, values), axis=-1)
        given = Image.fromarray(lattice.reshape(1, -1, 3))
    before = np.asarray(given.convert("RGB"), dtype=np.int16)
    return bool(np.abs(np.asarray(convert(given)) - before).max() <= ROUNDING)


def _profile(photo: Image.Image) -> bytes | Space:
    """The colour space in the file; empty: none, or sRGB. ValueError: it is damaged."""
    if photo.mode == "LAB":
        return _lab()
    path = getattr(photo, "filename", "")
    if photo.format == "PNG":
        with open(path, "rb", opener=regular) as file:
            if code := png_chunk(file, b"cICP", end=PIXELS):
                return space_of_code(code[0], code[1], limited=code[3] == 0)
    embedded: bytes | None = photo.info.get("icc_profile", b"")
    if embedded is None:  # incomplete, or cannot be decompressed
        raise ProfileError("an incomplete profile")
    if photo.format == "JPEG2000":
        embedded = _of_jpeg2000(path)
    if photo.format == "BMP":
        embedded = _of_bmp(path)
    if embedded and len(embedded) > MOST_PROFILE:
        raise ProfileError(f"a profile of {len(embedded) >> 20} MB")
    if embedded:
        return embedded
    if photo.format == "PNG":
        return _of_png(photo.info)
    if nclx := photo.info.get("nclx_profile"):
        return space_of_code(int(nclx["color_primaries"]), int(nclx["transfer_characteristics"]))
    return space_of_gamma(ADOBE_RGB, ADOBE_GAMMA) if _exif_says_adobe(photo) else b""


@lru_cache(maxsize=1)
def _lab() -> bytes:
    return ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()


def _of_png(info: dict[str | tuple[int, int], Any]) -> bytes | Space:
    """The space in the PNG chunks sRGB, cHRM and gAMA."""
    gamma, corners = info.get("gamma"), info.get("chromaticity")
    if "srgb" in info or (gamma is None and corners is None):
        return b""
    primaries = SRGB if corners is None else (*corners[2:], *corners[:2])
    if gamma is None or abs(gamma / GAMMA - 1) < GAMMA_TOLERANCE:
        return space_of_gamma(primaries, None)
    return space_of_gamma(primaries, 1 / gamma)


def _of_jpeg2000(path: str) -> bytes:
    """The profile in a JPEG 2000 file (ISO/IEC 15444-1, I.5.3.3), or empty."""
    with open(path, "rb", opener=regular) as file:
        end = file.seek(0, 2)
        for kind, start, stop in boxes(file, 0, end):
            if kind == b"jp2h":
                for inner, first, last in boxes(file, start, stop):
                    file.seek(first)
                    if inner == b"colr" and file.read(3)[:1] in (b"\2", b"\3"):
                        return file.read(last - first - 3)
    return b""


def _of_bmp(path: str) -> bytes:
    """The profile in a BMP file, located by its header (BITMAPV5HEADER), or empty."""
    with open(path, "rb", opener=regular) as file:
        head = file.read(14 + 124)
        if len(head) < 138 or head[14 + 56 : 14 + 60] != b"DEBM":
            return b""
        place, size = struct.unpack("<II", head[14 + 112 : 14 + 120])
        file.seek(14 + place)
        return file.read(size)


def _exif_says_adobe(photo: Image.Image) -> bool:
    if photo.format == "PNG":
        return False
    with suppress(Exception):  # Pillow's readers raise nearly anything on damaged tags
        tags = exif_of(photo)
        space = tags.get_ifd(EXIF_IFD).get(COLOUR_SPACE)
        index = str(tags.get_ifd(INTEROPERABILITY_IFD).get(INDEX, "")).strip("\0 ")
        return space == SAYS_ADOBE or (space != SAYS_SRGB and index == "R03")
    return False
