"""Reads COLMAP's model files, binary and text, as plain arrays.

pycolmap's reader is not used: on damaged files it can loop forever or allocate huge amounts of
memory, and it rejects a model with a single dangling observation. `rigs` and `frames` files are not
needed, since `images` has each photo's full pose.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats.files import UNREADABLE
from ..formats.projects import model_suffix
from . import binary_files, text_files
from .records import Model, ModelImage

T = TypeVar("T")

HINT_DAMAGED = "The file is damaged or incomplete: export the model again."


def read_model(folder: Path, context: Context = QUIET) -> Model:
    """The model in `folder`; binary files take precedence over text files.

    Args: `context`: checked for cancellation while reading.

    Raises:
        SceneError: a file is missing, unreadable or damaged.
    """
    suffix, files = _format(folder)
    points3d = folder / f"points3D{suffix}"
    if not points3d.is_file():
        raise SceneError(f"{folder} has no {points3d.name}.", "Export the 3D points as well.")
    cameras = _read(folder / f"cameras{suffix}", files.read_cameras)
    images = read_images(folder, context)
    # Normally the photos list what they observe; else the points' tracks are read.
    tracks = not any((image.point_ids >= 0).any() for image in images)
    parse = partial(files.read_points, tracks=tracks, context=context)
    ids, points, colors, rows, viewers = _read(points3d, parse)
    return Model(
        cameras=cameras,
        images=images,
        point_ids=ids,
        points=points,
        colors=colors,
        track_rows=rows,
        track_images=viewers,
    )


def read_images(folder: Path, context: Context = QUIET) -> list[ModelImage]:
    """The photos of the model in `folder`, from their own file alone. Raises as `read_model`."""
    suffix, files = _format(folder)
    return _read(folder / f"images{suffix}", partial(files.read_images, context=context))


def _format(folder: Path) -> tuple[str, ModuleType]:
    """The end of the names of a model's files, and the module that reads them."""
    suffix = model_suffix(folder)
    if suffix is None:
        raise SceneError(
            f"{folder} has no COLMAP model.",
            "It needs cameras, images and points3D, all .bin or all .txt.",
        )
    return suffix, binary_files if suffix == ".bin" else text_files


def count_images(folder: Path) -> int:
    """The number of posed photos in the model in `folder`; 0 if it cannot be read."""
    path = folder / f"images{model_suffix(folder)}"
    try:
        if path.suffix == ".bin":
            with path.open("rb") as file:
                number = int(struct.unpack("<Q", file.read(8))[0])
            return number if number * binary_files.SMALLEST_IMAGE <= path.stat().st_size else 0
        return sum(1 for _ in text_files.image_lines(path.read_bytes()))
    except (OSError, ValueError, struct.error):
        return 0


def _read(path: Path, parse: Callable[[bytes], T]) -> T:
    """`parse` of the file's bytes; any error becomes a SceneError that names the file."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    try:
        return parse(data)
    except struct.error as error:
        raise SceneError(f"{path} ends too early ({len(data)} bytes).", HINT_DAMAGED) from error
    except (ValueError, IndexError, OverflowError) as error:
        raise SceneError(f"Cannot read {path} ({error}).", HINT_DAMAGED) from error
