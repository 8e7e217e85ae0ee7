"""Opacity decay: each time the photos have gone round, all Gaussians lose a little opacity.

A photo that shows a Gaussian gives it back what it lost. What is behind others, what one photo in
many shows before the rest, and what no photo shows gets less back than it loses and fades, so that
few photos leave less in the air (opacity decay: Han et al. 2024; there it is the same in every
step, however many photos there are).

In a stage with masks, the surroundings of the boxes are drawn when whole photos are, in one of
`full_every` steps. They lose that part of the share, or they would fade that many times as fast.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


@torch.no_grad()
def decay_opacities(
    logit_opacities: Tensor, share: float, outside: Tensor | None = None, full_every: int = 1
) -> None:
    """Lower opacities in place by a share of what they are.

    Args:
        logit_opacities: (N,)
        share: 0 to 1.
        outside: (N,) bool, the Gaussians outside the boxes; they lose `share / full_every`.
        full_every: one step in so many uses a whole photo.
    """
    if share > 0:
        faded = _faded(logit_opacities, share)
        if outside is not None:
            faded = torch.where(outside, _faded(logit_opacities, share / full_every), faded)
        logit_opacities.copy_(faded)


def _faded(logit_opacities: Tensor, share: float) -> Tensor:
    # logit(d o) = log d - log(1 - d + exp(-x)) for the opacity o = 1 / (1 + exp(-x))
    lost = torch.full_like(logit_opacities, math.log(share))
    return math.log1p(-share) - torch.logaddexp(lost, -logit_opacities)
