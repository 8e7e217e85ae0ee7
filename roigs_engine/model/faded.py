"""Models that are partly there: a level of detail that fades."""

from __future__ import annotations

import torch
from torch import Tensor

MOST = 0.999
"""An opacity counts as at most this: one of 1 could not fade."""


def faded(logit_opacities: Tensor, density: float) -> Tensor:
    """The logits of opacities o that become 1 - (1 - o)^density; 1 keeps every bit.

    The optical depth is `density` times as large. So through two models of the same thing, with
    densities that add up to 1, as much light comes as through one.

    Args:
        logit_opacities: (N,).
        density: above 0, at most 1.
    """
    if density == 1:
        return logit_opacities
    # In float64, so that an opacity close to 0 keeps a finite logit.
    through = 1 - logit_opacities.double().sigmoid().clamp(max=MOST)
    return torch.logit(1 - through**density, eps=1e-12).float()
