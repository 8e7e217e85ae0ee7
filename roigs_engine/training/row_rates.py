"""Learning rates of single Gaussians: outside the boxes, steps on whole photos are larger (ours).

Most steps of the box stage look at masks (`masks.py`). The surroundings of the boxes have most of
their steps on whole photos, which are fewer: they learn faster in these, to come as far.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..model.gaussians import Gaussians
from ..model.ownership import owners
from ..model.roi import OrientedBox


def whole_photo_rates(
    gaussians: Gaussians, rois: Sequence[OrientedBox], outside_rate: float
) -> Tensor:
    """(N,) float32: the factors of the learning rates in steps on whole photos.

    Args:
        gaussians: N rows.
        rois: of the stage. Gaussians whose centre is in one have the factor 1.
        outside_rate: the factor of all others.
    """
    outside = owners(gaussians, rois) < 0
    return torch.where(outside, outside_rate, 1.0).to(torch.float32)
