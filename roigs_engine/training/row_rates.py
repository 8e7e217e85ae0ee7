"""Learning rates of single Gaussians: outside the boxes, steps on whole photos are larger (ours).

Most steps of the box stage look at masks (`masks.py`). What is beside the boxes has its steps on
whole photos alone, which are few: it learns faster in these, to come as far.
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
) -> Tensor | None:
    """(N,) factors of the learning rates in steps on whole photos; None: all are 1.

    Args:
        gaussians: N rows.
        rois: of the stage. Gaussians whose centre is in one have the factor 1.
        outside_rate: the factor of all others; 0: 1.
    """
    if not outside_rate:
        return None
    outside = owners(gaussians, rois) < 0
    return torch.where(outside, outside_rate, 1.0).to(torch.float32)
