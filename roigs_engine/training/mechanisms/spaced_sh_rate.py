"""SH learning rate by the angular spacing of the photos around the boxes (ours)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ...model.roi import OrientedBox
from ...model.scene import Float64, PosedImage
from ..config import Mechanism, PlannedViews, TrainConfig, limited

NEIGHBOUR = 3  # the third one: two photos side by side do not cover the directions around them
EXPONENT = 3.0


@dataclass(frozen=True, kw_only=True)
class SpacedShRate(Mechanism):
    """Lowers `lr_shN`, to 3DGS's at the least, where photos stand far apart around a box.

    SH of degree 3 vary within about 60 degrees. If the photos are far apart, none constrains the SH
    between them. Limit and exponent are empirical (notebook/few_photos.md). The paper keeps 3DGS's
    learning rate.

    Earns: 0.00 dB with all photos, which are close together (six boxes, two seeds). With 12 to 24
        photos, nine cuts: +0.11 dB on 18 objects (up to 1.2 dB in one cut of the demo, −0.2 dB on
        flowerpot's), +0.04 dB in their boxes (marginal; notebook/leave_one_out.md).

    Attributes:
        limit: the largest view spacing, degrees, at which the rate stays.
    """

    name: ClassVar[str] = "spaced_sh_rate"

    limit: float = limited(25.0, above=0)

    def planned(self, config: TrainConfig, views: PlannedViews) -> TrainConfig:
        return self.at(config, max(view_spacing(views.seen(roi), roi) for roi in views.rois))

    def at(self, config: TrainConfig, spacing: float) -> TrainConfig:
        """The config with the rate for a view spacing, degrees."""
        if spacing <= self.limit:
            return config
        rate = config.lr_shN * (self.limit / spacing) ** EXPONENT
        return replace(config, lr_shN=max(rate, min(config.lr_shN, TrainConfig.lr_shN)))


def view_directions(images: Sequence[PosedImage], roi: OrientedBox) -> Float64:
    """(V, 3) unit vectors from the box's centre to the photos; zeros for a photo in the centre."""
    rays: Float64 = np.array([image.centre for image in images]).reshape(-1, 3) - roi.centre
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    return rays


def view_spacing(images: Sequence[PosedImage], roi: OrientedBox) -> float:
    """Median angle between a photo and its third neighbour, seen from the box's centre, degrees.

    With fewer than three neighbours, the farthest one counts; 180 for fewer than two photos.
    """
    from scipy.spatial import cKDTree

    if len(images) < 2:
        return 180.0
    rays = view_directions(images, roi)
    count = min(NEIGHBOUR, len(rays) - 1)
    chords, _ = cKDTree(rays).query(rays, k=[count + 1])  # the first is the photo itself
    return float(np.median(np.degrees(2 * np.arcsin(np.clip(chords / 2, 0, 1)))))
