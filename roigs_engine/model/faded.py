"""Models that are partly there: a level of detail that fades."""

from __future__ import annotations

import torch
from torch import Tensor

LEAST = 0.2
"""Of the light that comes through a Gaussian, what is below this changes evenly with the density.

With powers alone, opaque Gaussians would come and go in the first steps of a fade: the largest
changes between the frames of a fly-in were twice as large.
"""


def faded(logit_opacities: Tensor, density: float) -> Tensor:
    """The logits of Gaussians of which only a share is there; 1 keeps every bit.

    Of a Gaussian that lets t >= LEAST of the light through, t^density comes through: through two
    models of the same thing, with densities that add up to 1, as much light comes as through one.
    The part of t that is below is scaled evenly from 1 to t / LEAST.

    Args:
        logit_opacities: (N,).
        density: above 0, at most 1.
    """
    if density == 1:
        return logit_opacities
    # In float64, so that an opacity close to 0 or 1 keeps a finite logit.
    through = (-logit_opacities.double()).sigmoid()
    upper = through.clamp(min=LEAST)
    through = upper**density * (1 - density * (1 - through / upper))
    return torch.logit(1 - through, eps=1e-12).float()
