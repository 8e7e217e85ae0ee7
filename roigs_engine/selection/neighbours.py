"""The exact nearest neighbours of every point of a set, with numpy alone.

The points are split at medians into leaves of a few dozen points. The points of a leaf give an
upper bound for the distance to each other's neighbours, and only leaves within the largest bound
are searched. If these are many leaves, as around outliers, points with small bounds are searched
separately.
"""

from __future__ import annotations

import numpy as np

from ..context import QUIET, Context
from ..model.scene import Float64, Int64

LEAF = 64  # most points of a leaf; a leaf has at least half of it, the largest number of neighbours
MANY = 100  # leaves to search


def nearest_neighbours(points: Float64, count: int, context: Context = QUIET) -> Int64:
    """(P, 3) points -> (P, count) rows of the nearest points, unordered, the point included.

    `count` is at most P and `LEAF` / 2.
    """
    assert count <= min(len(points), LEAF // 2)
    leaves = _leaves(points)
    low = np.array([points[leaf].min(axis=0) for leaf in leaves])
    high = np.array([points[leaf].max(axis=0) for leaf in leaves])
    found = np.empty((len(points), count), dtype=np.int64)
    for leaf in leaves:
        context.check_cancelled()
        centre = points[leaf].mean(axis=0)  # scalar products give exact distances near zero
        own = points[leaf] - centre
        bounds = np.maximum(_kth(_squared(own, own), count), 0.0)
        groups = [np.argsort(bounds)]
        while groups:
            group = groups.pop()
            rows = points[leaf[group]]
            gap = np.maximum(np.maximum(low - rows.max(axis=0), rows.min(axis=0) - high), 0.0)
            # Rounding must not lose a neighbour exactly at the bound.
            near = np.flatnonzero((gap**2).sum(axis=1) <= bounds[group[-1]] * (1 + 1e-9))
            if len(near) > MANY and len(group) > 1:
                groups += [group[: len(group) // 2], group[len(group) // 2 :]]
                continue
            others = np.concatenate([leaves[other] for other in near])
            distance = _squared(own[group], points[others] - centre)
            if len(others) > count:
                others = others[np.argpartition(distance, count - 1, axis=1)[:, :count]]
            found[leaf[group]] = others
    return found


def _leaves(points: Float64) -> list[Int64]:
    """Rows of the points, in groups of at most `LEAF` neighbouring points."""
    todo, leaves = [np.arange(len(points))], []
    while todo:
        rows = todo.pop()
        if len(rows) <= LEAF:
            leaves.append(rows)
            continue
        axis = int(np.ptp(points[rows], axis=0).argmax())
        middle = len(rows) // 2
        order = np.argpartition(points[rows, axis], middle)
        todo += [rows[order[:middle]], rows[order[middle:]]]
    return leaves


def _squared(a: Float64, b: Float64) -> Float64:
    """(A, 3), (B, 3) -> (A, B) squared distances."""
    squares: Float64 = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return squares


def _kth(distance: Float64, count: int) -> Float64:
    """(A, B) -> (A,) the count-th smallest of each row."""
    return np.partition(distance, count - 1, axis=1)[:, count - 1]
