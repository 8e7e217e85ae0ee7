"""Cropping a model to boxes, and merging object models into a scene model.

Source: ROI-GS, composition of Scene-GS and Object-GS (docs/method.md, composition).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from torch import Tensor

from ..errors import RoiError
from .gaussians import Gaussians
from .ownership import owners
from .roi import OrientedBox


def crop(gaussians: Gaussians, roi: OrientedBox, rois: Sequence[OrientedBox]) -> Gaussians:
    """The Gaussians that `roi` owns among all boxes `rois`.

    Raises:
        RoiError: no box of `rois` has the name of `roi`.
    """
    names = [other.name for other in rois]
    if roi.name not in names:
        raise RoiError(f"Box '{roi.name}' is not among the run's boxes ({', '.join(names)}).")
    return gaussians.rows(owners(gaussians, rois) == names.index(roi.name))


Owners = Callable[[Gaussians, Sequence[OrientedBox]], Tensor]
"""A model and the boxes -> (N,) the index of the box that owns each Gaussian, -1 for none."""


def merge(
    scene: Gaussians, objects: Sequence[tuple[OrientedBox, Gaussians]], owned: Owners = owners
) -> Gaussians:
    """The scene model with the content of each box taken from that box's object model.

    The result has the scene's Gaussians that no box owns, in their order, then for each box the
    object model's Gaussians that this box owns. Models with fewer SH bands are padded with zeros.
    The result is on the scene model's device. The inputs do not change.

    Args:
        scene: the scene model.
        objects: boxes and their models.
        owned: which box owns a Gaussian.
    """
    rois = [roi for roi, _ in objects]
    parts = [scene.rows(owned(scene, rois) == -1)]
    for index, (_, model) in enumerate(objects):
        parts.append(model.rows(owned(model, rois) == index))
    return Gaussians.concatenate([part.to(scene.means.device) for part in parts])
