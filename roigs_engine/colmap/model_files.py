"""Reading COLMAP's model files, binary and text, into plain arrays; every count is distrusted.

The readers do not rely on COLMAP's own: that one loops for ever or asks for absurd amounts of
memory on damaged files and rejects a model with a single dangling observation. `rigs` and `frames`
files are not needed, as `images` holds each photo's full pose, rig or not.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

from ..context import QUIET, Context
from ..errors import SceneError
from . import binary_files, text_files
from .records import Model

T = TypeVar("T")

HINT_DAMAGED = "The file is damaged or unfinished: export the model again."


def model_suffix(folder: Path) -> str | None:
    """`.bin` or `.txt` when `folder` holds a model's cameras and images in that form, else None."""
    for suffix in (".bin", ".txt"):
        if all((folder / (stem + suffix)).is_file() for stem in ("cameras", "images")):
            return suffix
    return None


def read_model(folder: Path, context: Context = QUIET) -> Model:
    """The model in `folder`, binary files before text ones.

    Args: `context`: checked for cancellation while reading.

    Raises:
        SceneError: a file is missing, unreadable or damaged.
    """
    suffix = model_suffix(folder)
    if suffix is None:
        raise SceneError(
            f"{folder} holds no COLMAP model.",
            "It needs cameras, images and points3D, all .bin or all .txt.",
        )
    paths = [folder / (stem + suffix) for stem in ("cameras", "images", "points3D")]
    if not paths[2].is_file():
        raise SceneError(f"{folder} holds no {paths[2].name}.", "Export the 3D points as well.")
    files = binary_files if suffix == ".bin" else text_files
    cameras = _read(paths[0], files.read_cameras)
    images = _read(paths[1], partial(files.read_images, context=context))
    # Normally the photos tell what they observe; the points' side is read only where they do not.
    tracks = not any((image.point_ids >= 0).any() for image in images)
    parse = partial(files.read_points, tracks=tracks, context=context)
    ids, points, colors, rows, viewers = _read(paths[2], parse)
    return Model(
        cameras=cameras,
        images=images,
        point_ids=ids,
        points=points,
        colors=colors,
        track_rows=rows,
        track_images=viewers,
    )


def count_images(folder: Path) -> int:
    """How many posed photos the model in `folder` says it holds; 0 when that cannot be read."""
    path = folder / f"images{model_suffix(folder)}"
    try:
        if path.suffix == ".bin":
            with path.open("rb") as file:
                number = int(struct.unpack("<Q", file.read(8))[0])
            return number if number * binary_files.SMALLEST_IMAGE <= path.stat().st_size else 0
        return sum(1 for _ in text_files.image_lines(path.read_bytes()))
    except (OSError, struct.error):
        return 0


def _read(path: Path, parse: Callable[[bytes], T]) -> T:
    """`parse` of the file's bytes; whatever goes wrong becomes one line that names the file."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"Cannot read {path} ({error.strerror}).") from error
    try:
        return parse(data)
    except struct.error as error:
        raise SceneError(f"{path} ends too early ({len(data)} bytes).", HINT_DAMAGED) from error
    except (ValueError, IndexError, OverflowError) as error:
        raise SceneError(f"Cannot read {path} ({error}).", HINT_DAMAGED) from error


# --- binary ---------------------------------------------------------------------------------------


# --- text -----------------------------------------------------------------------------------------
