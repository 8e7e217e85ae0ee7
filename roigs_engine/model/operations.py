"""Operations on models of Gaussians: crop to a box, merge, fade, change colours.

Source of crop and merge: ROI-GS, composition of Scene-GS and Object-GS (docs/method.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from ..errors import RoiError
from .gaussians import SH_C0, Gaussians
from .ownership import owners
from .roi import OrientedBox


def crop(gaussians: Gaussians, roi: OrientedBox, rois: Sequence[OrientedBox]) -> Gaussians:
    """The Gaussians that `roi` owns among all boxes `rois`; RoiError if none has its name."""
    names = [other.name for other in rois]
    if roi.name not in names:
        raise RoiError(f"Box '{roi.name}' is not among the run's boxes ({', '.join(names)}).")
    return gaussians.rows(owners(gaussians, rois) == names.index(roi.name))


Owners = Callable[[Gaussians, Sequence[OrientedBox]], Tensor]
"""A model and the boxes -> (N,) index of each Gaussian's box, -1 for none."""


def merge(
    scene: Gaussians, objects: Sequence[tuple[OrientedBox, Gaussians]], owned: Owners = owners
) -> Gaussians:
    """Replace the content of each box in the scene model by that of the box's object model.

    The result has the scene's Gaussians that no box owns, in their order, then for each box the
    object model's Gaussians that this box owns. Models with fewer SH bands are padded with zeros.
    The result is on the scene model's device. The inputs do not change.
    """
    rois = [roi for roi, _ in objects]
    parts = [scene.rows(owned(scene, rois) == -1)]
    for index, (_, model) in enumerate(objects):
        parts.append(model.rows(owned(model, rois) == index))
    return Gaussians.concatenate([part.to(scene.means.device) for part in parts])


LEAST = 0.2
"""Below this transmittance, the fade of a Gaussian is linear in the density, not a power.

With powers alone, opaque Gaussians would appear and vanish in the first steps of a fade: in a
fly-in, the largest changes between frames were twice as large.
"""


def faded(logit_opacities: Tensor, density: float) -> Tensor:
    """Opacity logits (N,) of Gaussians faded to a share `density`; 1 keeps every bit.

    A transmittance t >= LEAST becomes t^density. So two models of the same object with densities
    that add up to 1 transmit as much light as one. For t < LEAST, LEAST^density is multiplied by a
    factor that changes linearly with the density, from 1 to t / LEAST.
    """
    if density == 1:
        return logit_opacities
    # In float64, so that an opacity close to 0 or 1 keeps a finite logit.
    through = (-logit_opacities.double()).sigmoid()
    upper = through.clamp(min=LEAST)
    through = upper**density * (1 - density * (1 - through / upper))
    return torch.logit(1 - through, eps=1e-12).float()


def recoloured(sh: Tensor, gains: Sequence[float]) -> Tensor:
    """Multiply the colours of SH coefficients by `gains`, for all directions.

    Args:
        sh: (N, K, 3); a colour is max(0, 0.5 + sum of sh * basis), sRGB.
        gains: for red, green and blue, not negative. A gain of 1 keeps its channel bit for bit;
            if all are 1, `sh` itself is returned.
    """
    if all(gain == 1 for gain in gains):
        return sh
    factors = torch.as_tensor(gains, dtype=sh.dtype, device=sh.device)
    changed = sh * factors
    changed[:, 0] += 0.5 * (factors - 1) / SH_C0
    return changed
