"""Photos as training sees them: upright, undistorted, in sRGB."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..context import QUIET, Context
from ..formats.files import atomic_write
from ..photos.headers import content_digest, open_photo, photo_size, unreadable
from ..photos.rotation import AS_STORED, turned_size
from .records import ModelCamera
from .undistort import plan_undistortion, undistorted_photo

USUAL_FORMATS = ("JPEG", "MPO", "PNG", "BMP", "WEBP", "TIFF")  # other programs read these
USUAL_MODES = ("1", "L", "LA", "P", "RGB", "RGBA")
BITS, PHOTOMETRIC, PLANAR = 258, 262, 284  # tags of a TIFF
WHITE_IS_ZERO, SEPARATE = 0, 2
QUALITY = 95


def is_as_stored(path: Path) -> bool:
    """Whether programs that ignore profiles show a photo's file as training sees it.

    Also True for a file that cannot be opened.
    """
    with suppress(Exception):  # other code reports such photos; Pillow may be missing
        from ..photos.colours import colours_of

        with open_photo(path) as photo:
            usual = photo.format in USUAL_FORMATS and photo.mode in USUAL_MODES
            if photo.format == "TIFF":
                tags: Any = getattr(photo, "tag_v2", {BITS: (16,)})  # none: tifffile reads it
                usual &= max(tags.get(BITS, (1,))) <= 8
                usual &= tags.get(PHOTOMETRIC) != WHITE_IS_ZERO and tags.get(PLANAR) != SEPARATE
            return usual and not colours_of(photo).profile
    return True


def write_shown(
    path: Path,
    out: Path,
    context: Context = QUIET,
    *,
    lens: ModelCamera | None,
    turn: int = AS_STORED,
    side: int,
) -> None:
    """Write a photo as training sees it, as a JPEG with a longer side of at most `side`.

    Args:
        path, out: the photo's file, and the picture's.
        lens: the camera with the distortion; None: the photo has none.
        turn: how the stored pixels are turned (`photos.rotation`).
        side: px.

    Raises:
        SceneError: the photo cannot be read, or the camera cannot be undistorted.
        Stopped: on request.
    """
    picture = context.interruptible(lambda: _shown(path, lens, turn, side))
    with atomic_write(out, durable=False) as file:
        picture.save(file, format="JPEG", quality=QUALITY, subsampling=0)


def _shown(
    path: Path, lens: ModelCamera | None, turn: int, side: int
) -> Any:  # a picture of Pillow's
    from PIL import Image

    from ..photos.decode import decode

    def shrink(width: int, height: int) -> tuple[int, int]:
        share = min(1.0, side / max(width, height))
        return max(1, round(width * share)), max(1, round(height * share))

    size = turned_size(photo_size(path), turn)
    if lens is None:
        return Image.fromarray(decode(path, shrink(*size), turn))
    try:
        digest = content_digest(path)
    except OSError as error:
        raise unreadable(path, error) from error
    plan = plan_undistortion(path, lens, size, shrink, turn)
    return undistorted_photo(replace(plan, digest=digest))
