"""Measures the overlap of two clouds of points. No bpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float32]

STRAYS = 0.02
"""Share of the points left out at each end of each axis."""


def overlap(a: Points, b: Points) -> float:
    """Return intersection over union of the clouds' bounds; (N, 3) finite numbers each."""
    if not len(a) or not len(b):
        return 0.0
    (low_a, high_a), (low_b, high_b) = (
        np.quantile(points, (STRAYS, 1 - STRAYS), axis=0) for points in (a, b)
    )
    sides = np.minimum(high_a, high_b) - np.maximum(low_a, low_b)
    both = float(np.prod(np.maximum(sides, 0)))
    every = float(np.prod(high_a - low_a) + np.prod(high_b - low_b)) - both
    return both / every if every > 0 else 0.0
