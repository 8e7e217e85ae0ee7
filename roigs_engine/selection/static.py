"""`static`: rank photos by distance, projected area and keypoints (the paper's ablation 3)."""

from __future__ import annotations

import numpy as np

from ..model.scene import Float64
from .features import StaticFeatures
from .records import Picks


def order_static(features: StaticFeatures, count: int) -> Picks:
    """The `count` photos with the best sum of ranks of -distance, area and keypoints.

    Equal values share their mean rank; names break ties (candidates are in name order).
    """
    ranks = _ranks(features.distance) + _ranks(-features.area) + _ranks(-features.keypoints)
    return Picks(order=tuple(np.argsort(ranks, kind="stable")[:count].tolist()))


def _ranks(values: Float64) -> Float64:
    """(V,) -> (V,) ranks from 1, ascending; equal values share their mean rank."""
    _, index, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks: Float64 = (np.cumsum(counts) - (counts - 1) / 2)[index]
    return ranks
