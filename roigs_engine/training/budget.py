"""Gaussian budget: the most Gaussians in each box of the box stage (ours; paper: no limit).

A box with few pixels in the photos must not get so many Gaussians that it overfits these pixels. A
box that fills the photos must not make the model larger than Full Scene. The budget grows with the
square root of the number of pixels that show the box: twice as wide photos double it, and so do
four times as many photos, since photos overlap. Factor and root are empirical
(notebook/steps_and_budgets.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..context import QUIET, Context
from ..model.gaussians import Gaussians
from ..model.mask_coverage import counted_pixels, object_share
from ..model.ownership import count_owned
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from .config import TrainConfig

EXPONENT = 0.5


@dataclass(frozen=True, kw_only=True)
class BoxBudget:
    """Most Gaussians in a box at the start and at the end of densification."""

    begin: int
    end: int

    def at(self, progress: float) -> int:
        """The limit when the share `progress` (0 to 1) of the densification steps is done.

        It rises linearly. A constant limit would be used up by the first large gradients, before
        training shows where detail is missing.
        """
        return round(self.begin + (self.end - self.begin) * min(progress, 1.0))


def box_budgets(
    images: Sequence[PosedImage],
    rois: Sequence[OrientedBox],
    config: TrainConfig,
    context: Context = QUIET,
) -> tuple[int, ...] | None:
    """Each box's budget at the end, `box_budget` x pixels^0.5; None when there is no limit.

    Args:
        images: the stage's photos; each pixel in a box's silhouette counts, unless the photo's
            mask ignores it, or the mask of the box's object does not show it. Photos without such
            a mask count with the mean share that the masks leave of the silhouette.
        rois: the boxes.
        config: has `box_budget`.
        context: checked for cancellation between photos.
    """
    if not rois or config.box_budget <= 0:
        return None
    return tuple(int(config.box_budget * _pixels(roi, images, context) ** EXPONENT) for roi in rois)


def budgets_from(
    model: Gaussians, rois: Sequence[OrientedBox], ends: Sequence[int]
) -> list[BoxBudget]:
    """Budgets that rise from the number of Gaussians of `model` in each box to `ends`."""
    counts = count_owned(model, rois)
    return [
        BoxBudget(begin=min(count, end), end=end) for count, end in zip(counts, ends, strict=True)
    ]


def _pixels(roi: OrientedBox, images: Sequence[PosedImage], context: Context) -> float:
    """Number of pixels in the box's silhouette that count, over all photos."""
    shares = [share for image in images if (share := object_share(roi, image)) is not None]
    usual, pixels = (sum(shares) / len(shares) if shares else 1.0), 0.0
    for image in images:
        context.check_cancelled()
        share = 1.0 if roi.name in image.objects else usual
        pixels += share * counted_pixels(roi, image)
    return pixels
