"""Composition «replace»: every box's Gaussians in the scene give way to its object model's.

Source: ROI-GS, composition of Scene-GS and Object-GS (docs/method.md, composition).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..errors import RoiError
from .gaussians import Gaussians
from .ownership import nearest_owner
from .roi import OrientedBox


def owners(gaussians: Gaussians, rois: Sequence[OrientedBox]) -> Tensor:
    """(N,) index of the box that owns each Gaussian's centre, -1 for none, on the model's device.

    Where boxes overlap, the one whose centre is nearest in box units owns the Gaussian.
    """
    centres = gaussians.means.detach().cpu().double().numpy()
    return torch.from_numpy(nearest_owner(centres, list(rois))).to(gaussians.means.device)


def cut(gaussians: Gaussians, roi: OrientedBox, rois: Sequence[OrientedBox]) -> Gaussians:
    """The Gaussians that belong to `roi` among all boxes `rois` (found by its name).

    Raises:
        RoiError: `roi` is not one of `rois`.
    """
    names = [other.name for other in rois]
    if roi.name not in names:
        raise RoiError(f"ROI «{roi.name}» is not among the run's ROIs ({', '.join(names)}).")
    return gaussians.rows(owners(gaussians, rois) == names.index(roi.name))


def surroundings(gaussians: Gaussians, rois: Sequence[OrientedBox]) -> Gaussians:
    """The Gaussians that belong to none of the boxes: what `cut` leaves of them."""
    return gaussians.rows(owners(gaussians, rois) == -1)


def replace(scene: Gaussians, objects: Sequence[tuple[OrientedBox, Gaussians]]) -> Gaussians:
    """The scene model with each box's inside taken from that box's object model.

    The result holds the scene's Gaussians that belong to no box, in their order, then for each box
    the object model's Gaussians that belong to that box. Inputs are not changed; models with fewer
    spherical-harmonics bands get zeros, and everything comes to lie on the scene model's device.
    """
    rois = [roi for roi, _ in objects]
    parts = [surroundings(scene, rois)]
    for index, (_, model) in enumerate(objects):
        parts.append(model.rows(owners(model, rois) == index))
    bands = max(part.sh.shape[1] for part in parts)
    return Gaussians.concatenate([_adapted(part, bands, scene.means.device) for part in parts])


def _adapted(part: Gaussians, bands: int, device: torch.device) -> Gaussians:
    """The same Gaussians with `bands` spherical-harmonics coefficients, on `device`."""
    tensors = {name: tensor.to(device) for name, tensor in part.tensors().items()}
    padding = tensors["sh"].new_zeros(len(part), bands - part.sh.shape[1], 3)
    tensors["sh"] = torch.cat([tensors["sh"], padding], dim=1)
    return Gaussians(**tensors)
