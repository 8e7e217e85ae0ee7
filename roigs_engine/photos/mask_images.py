"""Reads and resamples masks of photos: of used pixels, or of an object's pixels.

A mask is (H, W) bool, True where a pixel counts. docs/files.md (Masks) describes the files, and the
resampling of masks.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from ..errors import SceneError
from ..formats.files import atomic_write
from ..model.scene import PhotoMask, PosedImage
from .decode import Pixels, deep_values, load_photo, opacity
from .headers import MAX_PIXELS, PhotoError, open_photo, open_png
from .rotation import AS_STORED, turned, turned_size

Mask = NDArray[np.bool_]

MOST_PIXELS = 50_000_000  # limit for masks larger than their photo
OPAQUE = 128  # least alpha of an opaque pixel
ALL, HALF = 255, 128  # least value of a resampled pixel in the mask
HINT = "Save it again as a PNG, remove it, or use no masks (--no-masks)."
OBJECT_HINT = "Save it again as a PNG, or remove it."


class MaskError(SceneError):
    """A mask cannot be used."""


def read_mask(
    path: Path,
    photo: tuple[int, int],
    *,
    inverted: bool = False,
    hint: str = HINT,
    turn: int = AS_STORED,
) -> Mask:
    """Read the mask in a file, a PNG of any depth, at the file's own size.

    Args:
        photo: (width, height) of its photo after `turn`; the mask must have its shape.
        inverted: whether black counts and all else is ignored.
        hint: what to do with a file that cannot be read.
        turn: of the photo, see `PosedImage`. A mask that only has the shape of the unturned photo
            is turned, too.

    Raises:
        MaskError: the file cannot be read, is an animation, or has another shape.
    """
    try:
        with open_png(path) as image:
            stored = turned_size(photo, turn)
            as_file = stored != photo and _fits(image.size, stored) > _fits(image.size, photo)
            _check(path, image, stored if as_file else photo)
            bright = _bright(image)
            if as_file:
                bright = turned(bright, turn)
    except (MemoryError, MaskError):
        raise
    except Exception as error:  # Pillow's readers raise nearly anything on damaged files
        raise MaskError(f"Cannot read the mask {path} ({_reason(path, error)}).", hint) from error
    return ~bright if inverted else bright


def has_alpha(path: Path) -> bool:
    """Whether a photo's file has an alpha channel, by its header."""
    try:
        with open_photo(path) as photo:
            return bool(photo.has_transparency_data)
    except Exception:  # decoding reports the error
        return False


def alpha_mask(path: Path) -> Mask:
    """Read the mask in a photo's alpha channel, at full size; PhotoError: it cannot be decoded."""
    with open_photo(path) as photo:
        alpha = opacity(photo)
    if alpha is None:
        raise PhotoError(f"{path} has lost its alpha channel.", "Restore the file.")
    return np.asarray(alpha >= OPAQUE)


def resized(mask: Mask, size: tuple[int, int], least: int = ALL) -> Mask:
    """Resample the mask to `size` = (width, height).

    `least`: with `ALL`, a pixel counts if all that it covers counts; with `HALF`, if half does.
    """
    if (mask.shape[1], mask.shape[0]) == size:
        return mask
    if least == ALL:
        columns = _all_covered(np.ascontiguousarray(mask.T), size[0])
        return _all_covered(np.ascontiguousarray(columns.T), size[1])
    grey = Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0)))
    smaller = np.array(grey.resize(size, Image.Resampling.BOX))
    return np.asarray(smaller >= least)


def _all_covered(mask: Mask, height: int) -> Mask:
    """Resample the mask (h, W) to `height`; a pixel counts if all rows that it touches count."""
    rows = np.arange(height)
    first, end = rows * len(mask) // height, -(-(rows + 1) * len(mask) // height)
    # A pixel covers the rows up to the next pixel's first row, and its own last row.
    return np.asarray(np.logical_and.reduceat(mask, first, axis=0) & mask[end - 1])


def mask_png(mask: Mask) -> bytes:
    """The file of a mask: a PNG of one bit."""
    file = io.BytesIO()
    Image.fromarray(mask).save(file, format="PNG")
    return file.getvalue()


def write_mask(path: Path, mask: Mask) -> None:
    """Write a mask as a PNG of one bit; RunFolderError if it cannot be written."""
    with atomic_write(path, durable=False) as file:
        file.write(mask_png(mask))


def load_mask(image: PosedImage) -> Mask | None:
    """Load the mask of a posed photo at its camera's size; None: all pixels count.

    If a file made by the engine is missing or damaged, it is recreated.

    Raises:
        MaskError, PhotoError: the mask or photo is missing or was changed.
        RunFolderError: a file of the engine cannot be recreated.
    """
    return None if image.mask is None else _loaded(image.mask, image, ALL)


def load_object_mask(image: PosedImage, box: str) -> Mask | None:
    """Load the mask of a box's object for a posed photo; None: it has none.

    Raises as `load_mask`.
    """
    mask = image.objects.get(box)
    return None if mask is None else _loaded(mask, image, HALF)


def _loaded(mask: PhotoMask, image: PosedImage, least: int) -> Mask:
    size = (image.camera.width, image.camera.height)
    try:
        return resized(stored_mask(mask.path), size, least)
    except (OSError, MaskError):
        mask.remake()
    return resized(stored_mask(mask.path), size, least)


def stored_mask(path: Path) -> Mask:
    """Read a mask that `write_mask` has written; MaskError if it is damaged."""
    try:
        with open_png(path) as image:
            return np.array(image.convert("1"))
    except (MemoryError, FileNotFoundError):
        raise
    except Exception as error:
        raise MaskError(f"Cannot read the mask {path} ({error}).", HINT) from error


def load_masked(image: PosedImage) -> Pixels:
    """Load a posed photo as `load_photo`, (H, W, 3); with its mask (H, W, 4) if it has one.

    The last channel is 255 where a pixel counts, else 0. Raises as `load_photo` and `load_mask`.
    """
    pixels, counted = load_photo(image), load_mask(image)
    if counted is None:
        return pixels
    return np.dstack([pixels, np.where(counted, np.uint8(255), np.uint8(0))])


def _fits(mask: tuple[int, int], photo: tuple[int, int]) -> bool:
    """Whether a mask has the photo's shape, rounded by at most a pixel."""
    return abs(mask[0] / photo[0] - mask[1] / photo[1]) <= 1 / photo[0] + 1 / photo[1]


def _check(path: Path, image: Image.Image, photo: tuple[int, int]) -> None:
    """Raise MaskError if the opened file cannot be the mask of a photo of that size."""
    (width, height), (across, down) = image.size, photo
    if width * height > min(MAX_PIXELS, max(across * down, MOST_PIXELS)):
        raise ValueError(f"its header says {width} x {height} pixels")
    if getattr(image, "n_frames", 1) > 1:
        raise MaskError(f"The mask {path} is an animation.", "Save it as one picture.")
    if not _fits(image.size, photo):
        raise MaskError(
            f"The mask {path} has {width} x {height} pixels, its photo {across} x {down}:"
            " another shape.",
            "Make it from the photo as it is on the disk, not turned or cropped, or remove it.",
        )


def _bright(image: Image.Image) -> Mask:
    """(H, W) whether pixels of an opened file are neither black nor transparent."""
    deep = deep_values(image)  # at full depth: 1 of 65,535 is not black
    alpha = opacity(image)
    if deep is None:
        deep = np.asarray(image.convert("RGBA"))[..., :3]
    bright: Mask = (deep > 0).any(axis=2)
    return bright if alpha is None else bright & (alpha >= OPAQUE)


def _reason(path: Path, error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if path.is_file() and not path.stat().st_size:
        return "the file is empty"
    return "it is no PNG" if isinstance(error, UnidentifiedImageError) else str(error)
