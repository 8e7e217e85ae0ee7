"""Up axes of files of Gaussians, and rotations between them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...context import Context
from ...errors import ConfigError
from ...exchange import formats
from ...exchange.arrays import turn
from ...formats.drawable import usable
from ...requests.models import Convert
from ..run_scene import up_in_run

if TYPE_CHECKING:
    from ...exchange.arrays import Arrays
    from ...model.scene import Float64

SCENE_UP = "-y"
"""Up axis of formats that keep the frame of a scene."""


def to_upright(request: Convert, path: Path, context: Context) -> Float64:
    """(4, 4) from a file's frame to one in which -y points up.

    The file's up axis comes from --from-up, else from the file, else from its format. A file with
    left-handed axes is always mirrored.
    """
    said = context.interruptible(lambda: formats.frame(path))
    if request.from_up is None:
        matrix: Float64 = turn(formats.format_of(path).up, SCENE_UP) @ said
    else:
        mirror = np.diag((np.linalg.det(said).round(), 1, 1, 1))
        matrix = turn(request.from_up, SCENE_UP) @ mirror
    return matrix


def to_home(request: Convert, path: Path, upright: Float64) -> Float64:
    """(4, 4) from a file's frame to that of the scene, with its boxes and photos.

    Formats with -y up keep the scene's frame, whatever axis points up in it. A file of another
    format was rotated. If OUT keeps the scene's frame, its up axis gives the rotation back.
    `upright` is the result of `to_upright`.
    """
    if formats.format_of(path).up == SCENE_UP:
        return np.eye(4)
    own = formats.format_of(request.out).up == SCENE_UP
    up = request.up if request.up and own else SCENE_UP
    return turn(SCENE_UP, up) @ upright


def warn_of_axes(source: Path, before: str, context: Context) -> None:
    """Warn if a run's model would lie on its side: some COLMAP models have another up axis."""
    up = up_in_run(source)
    if up not in (None, before):
        context.warn(
            f"The up axis of this model is {up}, not {before}, so it lies on its side now. "
            f"Choose {up} as its up axis (--from-up={up})."
        )


def turned(arrays: Arrays, matrix: Float64) -> Arrays:
    """Return the model after a rotation; for the identity, it stays the same bit by bit."""
    from ...exchange.transform import moved

    if (matrix == np.eye(4)).all():
        return arrays
    arrays = usable(arrays)
    if not len(arrays["means"]):
        raise ConfigError("The model has no Gaussians that can be drawn.", "Give another model.")
    return moved(arrays, matrix)
