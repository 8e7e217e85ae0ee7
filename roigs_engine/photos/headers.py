"""Photo headers: the size of a photo without decoding, and whether the file is complete.

JPEG and PNG headers are read here, five times as fast as by Pillow. Pillow reads other formats, and
only those in `FORMATS`. By default, it would look only at the content, and start Ghostscript for an
EPS file named 'photo.jpg'.
"""

from __future__ import annotations

import hashlib
import io
import os
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from ..errors import EngineError, SceneError
from ..formats.contents import LFS
from ..formats.files import regular
from .jpeg import (
    EXIF,
    JPEG_END,
    MOST_EXIF,
    MOST_SEGMENT,
    check_scans,
    jpeg_exif,
    jpeg_segments,
    jpeg_size,
)
from .jpeg2000 import STARTS as JPEG_2000
from .jpeg2000 import check_tiles
from .png import PNG, PNG_END, png_chunks
from .tiff_tags import check_tags

if TYPE_CHECKING:
    from PIL.Image import Exif, Image

JPEG = b"\xff\xd8"
FORMATS = ("JPEG", "PNG", "TIFF", "BMP", "WEBP", "JPEG2000", "PPM")  # as Pillow calls them
ORIENTATION = 0x0112  # EXIF and TIFF tag
TURN = "turn"  # key under which `open_photo` stores a TIFF's tag
PROFILE = "Raw profile type exif"  # text in a PNG, of ImageMagick
TAIL = 1 << 16  # bytes at the end of a file that are searched for the end marker
# A larger photo has a damaged or malicious header: the largest cameras today have 150 megapixels,
# and Pillow rejects more than 179.
MAX_PIXELS = 178_000_000
LONGEST = 65_535  # pixels of a side, as in JPEG: Pillow allocates memory for each row
# The treatment of a photo's colour space if it is not sRGB (`colours`).
CONVERTED, DAMAGED = "converted", "damaged profile"
# The user can do nothing about Pillow's warnings on a photo's metadata.
warnings.filterwarnings("ignore", module=r"PIL\.")


class PhotoError(SceneError):
    """A photo is missing, damaged or in a format that cannot be decoded."""


def content_digest(path: Path) -> str:
    """Hash of a photo's file, 32 hexadecimal digits; OSError if it cannot be read."""
    with open(path, "rb", opener=regular) as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def check_unchanged(path: Path, digest: str) -> None:
    """Raise PhotoError if a photo's file no longer has this digest; empty: unknown, no check."""
    try:
        same = not digest or content_digest(path) == digest
    except OSError as error:
        raise unreadable(path, error) from error
    if not same:
        raise PhotoError(
            f"{path} was changed while it was used.",
            "Put the photo back, or give the command again with --update.",
        )


def photo_size(path: Path) -> tuple[int, int]:
    """(width, height) from the file's header, without the orientation tag; PhotoError: damaged."""
    try:
        with open(path, "rb", opener=regular) as file:
            start = file.read(24)
            if start.startswith(PNG):
                width, height = struct.unpack(">II", start[16:])
            elif start.startswith(b"\xff\xd8"):
                width, height = jpeg_size(file)
            else:
                with open_photo(path) as photo:
                    width, height = photo.size
    except (OSError, ValueError, struct.error) as error:
        raise unreadable(path, error) from error
    if width * height > MAX_PIXELS or max(width, height) > LONGEST:
        limit = f"{MAX_PIXELS // 10**6} million, or {LONGEST:,} on a side"
        raise PhotoError(
            f"Cannot read photo {path} ({width} x {height} pixels: more than {limit}).",
            "Give smaller copies of the photos with --images, or restore the file.",
        )
    if not width * height:
        raise unreadable(path, ValueError(f"its header says {width} x {height} pixels"))
    return width, height


def check_complete(path: Path) -> None:
    """Check quickly that the file is complete, by its JPEG or PNG end marker; else PhotoError.

    If the marker is not near the end of the file, Pillow decides: a phone may have appended a film.
    Other formats are not checked. `decode.check_whole` decodes the photo.
    """
    try:
        with open(path, "rb", opener=regular) as file:
            start = file.read(len(PNG))
            # A JPEG's headers may contain a small copy of the photo, with its own end marker.
            headers = 0
            if start.startswith(b"\xff\xd8"):
                list(jpeg_segments(file))
                headers = file.tell()
            file.seek(max(headers, file.seek(0, os.SEEK_END) - TAIL))
            tail = file.read()
    except (OSError, ValueError, struct.error) as error:
        raise unreadable(path, error) from error
    mark = PNG_END if start == PNG else JPEG_END if start.startswith(b"\xff\xd8") else b""
    if mark not in tail:
        with open_photo(path) as photo, suppress(MemoryError):  # a photo this large is not checked
            photo.load()


@contextmanager
def open_photo(path: Path) -> Iterator[Image]:
    """Open the photo with Pillow; its errors in the block become a PhotoError.

    EngineError: it is a TIFF that needs tifffile, which is not installed.
    """
    from . import tiff

    try:
        with _opened(path) as photo:
            yield photo
    except (MemoryError, EngineError):
        raise
    except tiff.UnsupportedError as error:
        raise PhotoError(f"Photo {path} is not supported: {error}.", tiff.HINT) from error
    except Exception as error:  # Pillow's readers raise nearly anything on damaged files
        raise unreadable(path, error) from error


@contextmanager
def open_png(path: Path) -> Iterator[Image]:
    """Open a PNG with Pillow, which may raise nearly anything; OSError: it is a pipe."""
    from PIL import Image

    with open(path, "rb", opener=regular) as file:
        check_cost(file)
        with Image.open(file, formats=("PNG",)) as image:
            setattr(image, "filename", str(path))  # noqa: B010 - parts are read again by this name
            yield image


def _opened(path: Path) -> Image:
    """Open the photo with Pillow, or with tifffile if Pillow does not read it correctly."""
    from PIL import Image, UnidentifiedImageError

    from . import tiff

    with open(path, "rb", opener=regular) as file:
        check_cost(file)
    try:
        photo: Image.Image = Image.open(path, formats=FORMATS)
        if tiff.pillow_reads(photo):
            tiff.check_parts(photo)
            if photo.format == "TIFF" and (tag := exif_of(photo).get(ORIENTATION, 1)) != 1:
                photo.info[TURN] = tag
                exif_of(photo)[ORIENTATION] = 1  # Pillow turns only TIFFs by it
                photo._size = getattr(photo, "_tile_size", photo.size)
            return photo
        photo.close()
    except UnidentifiedImageError:
        if not tiff.is_tiff(path):
            raise
    photo = tiff.TiffPhoto(path)
    if photo.width * photo.height > MAX_PIXELS:
        raise ValueError(f"its header says {photo.width} x {photo.height} pixels")
    return photo


def open_picture(data: bytes, formats: tuple[str, ...]) -> Image:
    """Open a picture that another file embeds, after the checks of a photo.

    Pillow may raise nearly anything on damaged data.
    """
    from PIL import Image

    file = io.BytesIO(data)
    check_cost(file)
    return Image.open(file, formats=formats)


def check_cost(file: BinaryIO) -> None:
    """Raise ValueError if a picture would take Pillow far longer than others of its size.

    Damage of other kinds is left to Pillow, which gets `file` at its beginning.
    """
    start = file.read(max(map(len, (*JPEG_2000, PNG))))
    if start.startswith(JPEG):
        with suppress(struct.error):
            if len(data := jpeg_exif(file)) > MOST_SEGMENT:  # Pillow reads them to open it
                check_tags(io.BytesIO(data))
        check_scans(file)
    elif start.startswith(PNG):
        for _ in png_chunks(file):
            pass
    elif start.startswith(JPEG_2000):
        check_tiles(file)
    else:
        file.seek(0)
        check_tags(file)
    file.seek(0)


def exif_of(photo: Image) -> Exif:
    """The EXIF tags of an opened photo; of damaged or far too long data, none."""
    from PIL.Image import Exif

    if photo.format == "PNG" and "exif" not in photo.info:
        photo.load()  # they may follow the pixels
    text = photo.info.pop(PROFILE, "")
    try:
        if text and "exif" not in photo.info:
            photo.info["exif"] = bytes.fromhex("".join(str(text).split("\n")[3:]))
        data = bytes(photo.info.get("exif") or b"")
        if len(data) > MOST_EXIF + len(EXIF):
            return Exif()
        check_tags(io.BytesIO(data.removeprefix(EXIF)))
    except (TypeError, ValueError):  # the pixels are good
        return Exif()
    return photo.getexif()


def unreadable(path: Path, error: Exception) -> PhotoError:
    """The error for a photo that cannot be opened or decoded."""
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    hint = "Restore the file, or remove it from the model."
    if isinstance(error, PermissionError):
        return PhotoError(f"Cannot read photo {path} ({reason}).", "Allow it (chmod +r).")
    kind = _kind(path)
    if kind == EMPTY or type(error).__name__ == "UnidentifiedImageError":
        reason = kind or "it is no picture"
        if kind not in ("", EMPTY, NOT_FETCHED):
            hint = "Convert the photos to JPEG, without turning them."
    return PhotoError(f"Cannot read photo {path} ({reason}).", hint)


EMPTY = "the file is empty"
NOT_FETCHED = "it is a pointer of Git LFS; git lfs pull fetches the photo"
BRANDS = {
    "HEIC": (b"heic", b"heix", b"hevc", b"heim", b"heis", b"mif1", b"msf1"),
    "AVIF": (b"avif", b"avis"),
    "CR3": (b"crx ",),
    "video": (b"isom", b"iso2", b"mp41", b"mp42", b"qt  "),
}
STARTS = {
    "GIF": (b"GIF8",),
    "PSD": (b"8BPS",),
    "OpenEXR": (b"v/1\x01",),
    "Radiance HDR": (b"#?",),
    "JPEG XL": (b"\xff\x0a", b"\0\0\0\x0cJXL "),
    "RAW": (b"FUJIFILM", b"\0MRM"),
    "PDF": (b"%PDF",),
    "web page": (b"<!doctype", b"<!DOCTYPE", b"<html"),
}


def _kind(path: Path) -> str:
    """The real kind of a file that is not a photo; empty if unknown."""
    try:
        with open(path, "rb", opener=regular) as file:
            start = file.read(32)
    except OSError:
        return ""
    if not start:
        return EMPTY
    if start.startswith(LFS):
        return NOT_FETCHED
    brand = start[8:12] if start[4:8] == b"ftyp" else b""
    kinds = [kind for kind, brands in BRANDS.items() if brand in brands]
    kinds += [kind for kind, starts in STARTS.items() if start.startswith(starts)]
    return f"its format, {kinds[0]}, is not supported" if kinds else ""
