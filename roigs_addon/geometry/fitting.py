"""Fits boxes to points, in a frame along the box's axes, with its centre at 0. No bpy."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]
Bounds = tuple[Vectors, Vectors]
"""Lower and upper corner."""

FEWEST = 10
CELLS = 24  # cells along the longest side in which points are counted; fewer for few points
PER_CELL = 2.25  # points per cell, if they all lay on one face of the cube of cells
SPARSE = 0.1  # a point with less than this share of the median number of neighbours is an outlier
MARGIN = 0.02  # added at each side, as a share of the size
TELLING = 3  # a part with none of this many expected points counts as empty: by Poisson's law,
# 95 % of parts with so many have some
UNSURE = 0.05  # points are too few if a part of this share of the size may well have none
AROUND = 2.0  # the floor is sought this far around the box, in half sides
BELOW = 3.0  # and this far below its centre, in halves of its longest side
STEP = 0.02  # resolution of the floor's height, in halves of its longest side


def tight(points: Vectors, half_sides: Vectors | None = None) -> Bounds | None:
    """Return the bounds of points (N, 3) without outliers, which have few neighbours.

    None if there are too few points.

    Args:
        points: to fit to.
        half_sides: of a box around the whole object. Where the outermost points are far apart, as
            on a smooth part, the object may extend beyond them: there, less of the box is cut off.
    """
    if len(points) < FEWEST:
        return None
    dense = points[_is_dense(points)]
    if len(dense) < FEWEST:
        return None
    low, high = dense.min(axis=0), dense.max(axis=0)
    margin = MARGIN * np.maximum(high - low, (high - low).max() * 0.1)
    outer_low, outer_high = low - margin, high + margin
    if half_sides is not None:
        ordered = np.sort(dense, axis=0)
        low -= ordered[TELLING] - ordered[0]
        high += ordered[-1] - ordered[-1 - TELLING]
        outer_low = np.minimum(outer_low, np.maximum(low, -half_sides))
        outer_high = np.maximum(outer_high, np.minimum(high, half_sides))
    return outer_low, outer_high


def is_unsure(points: Vectors) -> bool:
    """Whether points (N, 3) are so few that the object may be larger than their bounds."""
    return len(points) * UNSURE < TELLING


def _is_dense(points: Vectors) -> NDArray[np.bool_]:
    """(N,) whether the cell of each point and the cells around it have many points."""
    low = points.min(axis=0)
    count = min(CELLS, max(2, int(np.sqrt(len(points) / PER_CELL))))
    side = max(float(np.ptp(points, axis=0).max()) / count, 1e-12)
    cells = ((points - low) / side).astype(int) + 1
    counts = np.zeros(cells.max(axis=0) + 2, int)
    np.add.at(counts, tuple(cells.T), 1)
    around = sum(counts[tuple((cells + shift).T)] for shift in product((-1, 0, 1), repeat=3))
    others = np.asarray(around) - 1
    # If there are few points, most may lie on a textured part. The others are then no outliers.
    usual = 0.0 if is_unsure(points) else SPARSE * float(np.median(others))
    return np.asarray(others >= max(1.0, usual))


def floor(points: Vectors, half_sides: Vectors, up: int, sign: int) -> float | None:
    """Find the floor along an axis of the box: the height of most points around it.

    Args:
        points: (N, 3), also those outside the box.
        half_sides: of the box.
        up: the axis that points up or down.
        sign: 1 if it points up, else -1.

    Returns:
        Coordinate along the axis; None if too few points are around the box and below its centre.
    """
    flat = [axis for axis in range(3) if axis != up]
    across = np.abs(points[:, flat]) / half_sides[flat]
    heights, size = sign * points[:, up], float(half_sides.max())
    ring = (across <= AROUND).all(axis=1) & (across > 1).any(axis=1)
    found = heights[ring & (heights < 0) & (heights > -BELOW * size)]
    if len(found) < FEWEST:
        return None
    counts, edges = np.histogram(found, np.arange(-BELOW * size, STEP * size, STEP * size))
    at = int(np.argmax(np.convolve(counts, (1, 1, 1), "same")))
    near = found[np.abs(found - (edges[at] + edges[at + 1]) / 2) <= 1.5 * STEP * size]
    return sign * float(np.median(near))
