"""Confidence of Gaussians as columns of a PLY and as colours; numpy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

COLUMNS = ("photos", "directions", "error")
"""Number of photos that show a Gaussian, of their directions (of 128), error in held-out photos."""

FULL = 0.95  # the brightest colour starts at this quantile of the numbers of directions
STOPS = np.array(((0.0, 0.13, 0.31), (0.49, 0.48, 0.47), (1.0, 0.91, 0.22)))
"""sRGB of few, some and many: blue, grey, yellow, distinguishable with any colour vision."""


def most_directions(directions: Float32) -> float:
    """(N,) numbers of directions -> the number that gets the brightest colour; at least 1."""
    found = directions[np.isfinite(directions)]
    return max(1.0, float(np.quantile(found, FULL))) if len(found) else 1.0


def colours(directions: Float32, most: float) -> Float32:
    """(N,) numbers of directions -> (N, 3) sRGB; `most` and more are brightest. NaN is dark."""
    share = np.minimum(np.nan_to_num(directions) / most, 1.0)
    found = [np.interp(share, (0, 0.5, 1), STOPS[:, band]) for band in range(3)]
    return np.stack(found, axis=1).astype(np.float32)
