"""Gaussians that let more through, such as those of a level of detail that is fading out."""

from __future__ import annotations

import torch
from torch import Tensor


def faded(logit_opacities: Tensor, factor: float) -> Tensor:
    """The logits of opacities that are `factor` times as large; 1 keeps every bit.

    Args:
        logit_opacities: (N,).
        factor: above 0, at most 1.
    """
    if factor == 1:
        return logit_opacities
    # In float64, so that an opacity close to 0 or 1 keeps a finite logit.
    return torch.logit(logit_opacities.double().sigmoid() * factor, eps=1e-12).float()
