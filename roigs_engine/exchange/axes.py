"""Which way is up in a file, and turning a model that way."""

from __future__ import annotations

import numpy as np

from ..model.scene import Float64

UP: dict[str, tuple[tuple[int, int, int], ...]] = {
    "-y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
}
"""Axis that points up -> rotation from the world whose z axis does."""


def turn(before: str, after: str) -> Float64:
    """(4, 4) that makes the axis `after` point up in a model in which the axis `before` does."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(UP[after]) @ np.array(UP[before]).T
    return matrix
