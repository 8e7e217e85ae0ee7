"""The Gaussians outside the boxes, in a stage with masks (`masks.py`).

Most of its steps look at the boxes alone. The surroundings have most of their steps on whole
photos, which are fewer. So they learn faster in these, to come as far, and can lose less opacity
meanwhile (ours).
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
        outside_rate: their factor in steps on whole photos; 0: that of the others.
        whole: whether the step uses a whole photo.
    """
    if outside is None or not whole or not outside_rate:
        return None
    return torch.where(outside, outside_rate, 1.0).to(torch.float32)


def row_decay(outside: Tensor | None, config: TrainConfig) -> float | Tensor:
    """The share of its opacity that each Gaussian loses in a decay: one for all, or (N,) float64.

    Args:
        outside: see `outside_boxes`.
        config: of the stage.
    """
    share = config.opacity_decay
    if outside is None or not config.outside_spared:
        return share
    shares = torch.full(outside.shape, share, dtype=torch.float64, device=outside.device)
    return shares.masked_fill_(outside, share * (1 - config.outside_spared))
