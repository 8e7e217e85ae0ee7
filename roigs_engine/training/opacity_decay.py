"""Opacity decay: each time the photos have gone round, all Gaussians lose a little opacity.

A photo that shows a Gaussian gives it back what it lost. What is behind others, what one photo in
many shows before the rest, and what no photo shows gets less back than it loses and fades, so that
few photos leave less in the air (opacity decay: Han et al. 2024; there it is the same in every
step, however many photos there are).
"""

from __future__ import annotations

import torch
from torch import Tensor


@torch.no_grad()
def decay_opacities(logit_opacities: Tensor, share: float | Tensor) -> None:
    """Lower opacities in place by a share of what they are.

    Args:
        logit_opacities: (N,).
        share: one in [0, 1) for all, or (N,).
    """
    # logit(d o) = log d - log(1 - d + exp(-x)) for the opacity o = 1 / (1 + exp(-x))
    shares = torch.as_tensor(share, dtype=torch.float64, device=logit_opacities.device)
    lost, kept = (logs.to(logit_opacities) for logs in (shares.log(), torch.log1p(-shares)))
    logit_opacities.copy_(kept - torch.logaddexp(lost, -logit_opacities))
