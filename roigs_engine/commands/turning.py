"""Models turned upright, and with fewer SH, before they are written in another format."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ConfigError
from ..formats.drawable import usable
from .console import Console
from .run_scene import up_in_run

if TYPE_CHECKING:
    from ..exchange.arrays import Arrays
    from ..model.scene import Float64


def warn_of_axes(source: Path, before: str, console: Console) -> None:
    """Say so if a run's model would lie on its side: some COLMAP models have another axis up."""
    up = up_in_run(source)
    if up not in (None, before):
        console.context.warn(
            f"In this model, {up} points up, and not {before}, so it lies on its side now."
            f" Choose {up} as its axis that points up (--from-up={up})."
        )


def shortened(arrays: Arrays, args: argparse.Namespace) -> Arrays:
    """With the SH that were asked for."""
    if args.sh_degree is None:
        return arrays
    return {**arrays, "sh": arrays["sh"][:, : (args.sh_degree + 1) ** 2]}


def turned(arrays: Arrays, matrix: Float64) -> Arrays:
    """The model after a rotation; bit for bit the same if that changes nothing."""
    from ..exchange.moved import moved

    return arrays if (matrix == np.eye(4)).all() else moved(_drawable(arrays), matrix)


def _drawable(arrays: Arrays) -> Arrays:
    """The Gaussians that can be turned."""
    arrays = usable(arrays)
    if not len(arrays["means"]):
        raise ConfigError("The model has no Gaussians that can be drawn.", "Give another model.")
    return arrays
