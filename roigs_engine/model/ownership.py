"""Which box owns a position: the one rule of the project."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .roi import OrientedBox
from .scene import Float64


def nearest_owner(points: Float64, rois: list[OrientedBox]) -> NDArray[np.int64]:
    """(N, 3) -> (N,) index of the box each position belongs to, -1 for none.

    Overlapping boxes: the box whose centre is nearest in box units owns the point.
    """
    owner = np.full(len(points), -1, dtype=np.int64)
    best = np.full(len(points), np.inf)
    for index, roi in enumerate(rois):
        local = roi.to_box(points)
        with np.errstate(all="ignore"):
            distance = np.linalg.norm(local, axis=1)
        mine = (np.abs(local) <= 1).all(axis=1) & (distance < best)
        owner[mine], best[mine] = index, distance[mine]
    return owner
