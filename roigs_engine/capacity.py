"""How many Gaussians a box may come to hold in the ROI stage, and how fast (ours; paper: no limit).

Two limits hold together. A box that few photos see must not get more parameters than there are
observed values, or it learns those photos by heart. And all boxes together may add only a share of
the model they start from, or a box that fills the photos makes the model larger than the plain one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .config import TrainConfig
from .densify import box_owner
from .gaussians import Gaussians
from .roi import OrientedBox
from .scene import Camera, PosedImage

# Floats that make up one Gaussian: 3 position, 4 rotation, 3 scale, 1 opacity, 48 colour.
PARAMETERS = 59
CHANNELS = 3
THUMBNAIL = 256  # pixels; silhouettes are measured at this size


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
) -> list[BoxCapacity] | None:
    """The boxes' capacities, or None when the config sets no limit.

    Args:
        model: what the ROI stage starts from.
        images: what it trains on.
        rois: the boxes.
        config: `box_capacity` and `box_growth`.
    """
    if not rois or (config.box_capacity <= 0 and config.box_growth <= 0):
        return None
    owner = box_owner(model, rois).numpy()
    pixels = np.array([_pixels(roi, images) for roi in rois])
    budget = config.box_growth * len(model) * pixels / max(pixels.sum(), 1.0)
    capacities = []
    for index, seen in enumerate(pixels):
        inside = int((owner == index).sum())
        limits = []
        if config.box_capacity > 0:
            limits.append(config.box_capacity * CHANNELS * seen / PARAMETERS)
        if config.box_growth > 0:
            limits.append(inside + budget[index])
        end = int(min(limits))
        capacities.append(BoxCapacity(begin=min(inside, end), end=end))
    return capacities


def _pixels(roi: OrientedBox, images: Sequence[PosedImage]) -> float:
    """Pixels of all photos that lie in the box's silhouette."""
    return sum(
        roi.projected_area(_thumbnail(i.camera), i.world_to_camera)
        * i.camera.width
        * i.camera.height
        for i in images
    )


def _thumbnail(camera: Camera) -> Camera:
    scale = min(1.0, THUMBNAIL / max(camera.width, camera.height))
    return camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
