"""Finds the affine map that moved most points of a cloud. No bpy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .frames import Matrix

Points = NDArray[np.float32]

SAMPLE = 20_000  # about how many points the map is fitted to
ROUNDS = 30
ROUNDING = 1e-5  # allowed error, as a share of a point's distance from the origin plus the median
DIMENSIONS = 3
FEWEST = 20  # points; a map can always be found for some of fewer
MOST = 0.5  # a map must fit more than this share of the points


def common_map(before: NDArray[np.floating[Any]], now: Points) -> Matrix:
    """(4, 4) affine map from most points of `before` to `now`, (N, 3) finite numbers each.

    The identity if there is no such map, or if there are too few points.

    A minority of points may have moved in other ways.
    """
    step = max(1, len(before) // SAMPLE)
    source, target = before[::step].astype(np.float64), now[::step].astype(np.float64)
    if len(source) < FEWEST:
        return np.eye(4)
    distances = np.linalg.norm(target, axis=1)
    allowed = ROUNDING * (distances + np.median(distances))
    found: Matrix | None = np.eye(4)
    for _ in range(ROUNDS):  # least trimmed squares
        if found is None:
            break
        errors = np.linalg.norm(source @ found[:3, :3].T + found[:3, 3] - target, axis=1)
        if np.mean(errors <= allowed) > MOST:
            return found
        kept = errors <= np.median(errors)
        found = _fit(source[kept], target[kept])
    return np.eye(4)


def _fit(source: Matrix, target: Matrix) -> Matrix | None:
    """The least-squares map; None if the points are in a plane before or after it."""
    centre = source.mean(axis=0)
    linear, _, rank, _ = np.linalg.lstsq(source - centre, target - target.mean(axis=0), rcond=None)
    if rank < DIMENSIONS or np.linalg.matrix_rank(linear) < DIMENSIONS:
        return None
    found = np.eye(4)
    found[:3, :3] = linear.T
    found[:3, 3] = target.mean(axis=0) - linear.T @ centre
    return found
