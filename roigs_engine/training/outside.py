"""The Gaussians outside the boxes, in a stage with masks (`masks.py`).

Most of its steps look at the boxes alone. The surroundings have most of their steps on whole
photos, which are fewer: they learn faster in these, to come as far (ours).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..model.gaussians import Gaussians
from ..model.ownership import owners
from ..model.roi import OrientedBox
from .config import TrainConfig


def outside_boxes(
    gaussians: Gaussians, rois: Sequence[OrientedBox], config: TrainConfig
) -> Tensor | None:
    """(N,) bool: the Gaussians whose centre is in no box; None if the stage need not tell."""
    return owners(gaussians, rois) < 0 if config.tells_outside else None


def row_rates(outside: Tensor | None, outside_rate: float, *, whole: bool) -> Tensor | None:
    """(N,) float32: the factors of the learning rates in a step; None: all are 1.

    Args:
        outside: see `outside_boxes`.
        outside_rate: their factor in steps on whole photos.
        whole: whether the step uses a whole photo.
    """
    if outside is None or not whole:
        return None
    return torch.where(outside, outside_rate, 1.0).to(torch.float32)
