"""Groups of neighbouring points, as the leaves of a k-d tree."""

from __future__ import annotations

import numpy as np

from .scene import Float64, Int64

LEAF = 64
"""Most points in a leaf. Each leaf has at least half as many, unless there are fewer in all."""


def leaves_of(points: Float64) -> list[Int64]:
    """Rows of the points (P, 3), in groups of at most `LEAF` neighbouring points."""
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
