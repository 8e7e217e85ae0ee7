"""How many Gaussians a box may come to hold in the ROI stage, and how fast (ours; paper: no limit).

A box that few photos see, or that is small in them, must not get so many that it overfits those
photos; one that fills the photos must not make the model larger than the plain one. The budget
grows with the pixels that the photos show of the box, but more slowly: photos overlap, so twice the
pixels are not twice the surface. Factor and exponent are empirical (docs/lab_notebook.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..context import QUIET, Context
from ..model.gaussians import Gaussians
from ..model.ownership import count_owned
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from .config import TrainConfig

EXPONENT = 0.7


@dataclass(frozen=True, kw_only=True)
class BoxBudget:
    """Most Gaussians in a box when densification begins, and when it ends."""

    begin: int
    end: int

    def at(self, progress: float) -> int:
        """The limit when `progress` (0 to 1) of the densifying steps are done.

        It rises evenly: room given out at once would go to whatever had a large gradient first,
        before it is known where detail is missing.
        """
        return round(self.begin + (self.end - self.begin) * min(progress, 1.0))


def box_budgets(
    images: Sequence[PosedImage],
    rois: Sequence[OrientedBox],
    config: TrainConfig,
    context: Context = QUIET,
) -> tuple[int, ...] | None:
    """Each box's budget at the end, `box_budget` x pixels^0.7; None when there is no limit.

    Args:
        images: what the stage trains on; pixels count in each of them.
        rois: the boxes.
        config: gives `box_budget`.
        context: checked for cancellation between photos.
    """
    if not rois or config.box_budget <= 0:
        return None
    return tuple(int(config.box_budget * _pixels(roi, images, context) ** EXPONENT) for roi in rois)


def budgets_from(
    model: Gaussians, rois: Sequence[OrientedBox], ends: Sequence[int]
) -> list[BoxBudget]:
    """Budgets that rise from what `model` holds in the boxes to `ends`, one for each box."""
    counts = count_owned(model, rois)
    return [
        BoxBudget(begin=min(count, end), end=end) for count, end in zip(counts, ends, strict=True)
    ]


def _pixels(roi: OrientedBox, images: Sequence[PosedImage], context: Context) -> float:
    """Pixels of all photos that lie in the box's silhouette."""
    pixels = 0.0
    for image in images:
        context.check_cancelled()
        pixels += roi.projected_pixels(image.camera, image.world_to_camera)
    return pixels
