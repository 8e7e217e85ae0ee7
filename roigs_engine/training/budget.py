"""How many Gaussians a box may come to hold in the ROI stage, and how fast (ours; paper: no limit).

A box that few photos see, or that is small in them, must not get so many that it learns those
photos by heart; one that fills the photos must not make the model larger than the plain one. The
limit grows with the pixels that the photos show of the box, but more slowly: photos overlap, so
twice the pixels are not twice the surface. Factor and exponent are empirical (docs/results.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..context import QUIET, Context
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from .config import TrainConfig
from .densify import box_owner

EXPONENT = 0.7


@dataclass(frozen=True, kw_only=True)
class BoxCapacity:
    """Most Gaussians in a box when densification begins, and when it ends."""

    begin: int
    end: int

    def at(self, progress: float) -> int:
        """The limit when `progress` (0 to 1) of the densifying steps are done.

        It rises evenly: room given out at once would go to whatever had a large gradient first,
        before it is known where detail is missing.
        """
        return round(self.begin + (self.end - self.begin) * min(progress, 1.0))


def box_capacities(
    model: Gaussians,
    images: Sequence[PosedImage],
    rois: Sequence[OrientedBox],
    config: TrainConfig,
    context: Context = QUIET,
) -> list[BoxCapacity] | None:
    """The boxes' capacities, `box_capacity` x pixels^0.7, or None when the config sets no limit.

    Args:
        model: what the ROI stage starts from.
        images: what it trains on; pixels count in each of them.
        rois: the boxes.
        config: gives `box_capacity`.
        context: asked between photos whether to stop.
    """
    if not rois or config.box_capacity <= 0:
        return None
    ends = [int(config.box_capacity * _pixels(roi, images, context) ** EXPONENT) for roi in rois]
    return capacities_to(model, rois, ends)


def capacities_to(
    model: Gaussians, rois: Sequence[OrientedBox], ends: Sequence[int]
) -> list[BoxCapacity]:
    """Capacities that rise from what `model` holds in the boxes to `ends`, one for each box."""
    owner = box_owner(model, rois)
    return [
        BoxCapacity(begin=min(int((owner == index).sum()), end), end=end)
        for index, end in enumerate(ends)
    ]


def _pixels(roi: OrientedBox, images: Sequence[PosedImage], context: Context) -> float:
    """Pixels of all photos that lie in the box's silhouette."""
    pixels = 0.0
    for image in images:
        context.check_cancelled()
        pixels += roi.projected_pixels(image.camera, image.world_to_camera)
    return pixels
