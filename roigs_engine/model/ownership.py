"""Ownership: which box owns a position or a Gaussian.

A box owns the positions inside it. Where boxes overlap, the box with the nearest centre is the
owner, with distances in units of each box's half extents.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .roi import OrientedBox
from .scene import Float64

if TYPE_CHECKING:
    from torch import Tensor

    from .gaussians import Gaussians


def nearest_owner(points: Float64, rois: Sequence[OrientedBox]) -> NDArray[np.int64]:
    """(N, 3) world positions -> (N,) index of the box that owns each, -1 for none."""
    owner = np.full(len(points), -1, dtype=np.int64)
    best = np.full(len(points), np.inf)
    for index, roi in enumerate(rois):
        local = roi.to_box(points)
        with np.errstate(all="ignore"):
            distance = np.linalg.norm(local, axis=1)
        mine = (np.abs(local) <= 1).all(axis=1) & (distance < best)
        owner[mine], best[mine] = index, distance[mine]
    return owner


def owners(gaussians: Gaussians, rois: Sequence[OrientedBox]) -> Tensor:
    """(N,) index of the box that owns each Gaussian's centre, -1 for none; on the model's device.

    Always computed on the CPU, so that all devices give the same owners.
    """
    import torch

    centres = gaussians.means.detach().cpu().double().numpy()
    return torch.from_numpy(nearest_owner(centres, rois)).to(gaussians.means.device)


def count_owned(gaussians: Gaussians, rois: Sequence[OrientedBox]) -> list[int]:
    """The number of Gaussians that each box owns."""
    centres = gaussians.means.detach().cpu().double().numpy()
    owner = nearest_owner(centres, rois)
    return [int((owner == index).sum()) for index in range(len(rois))]
