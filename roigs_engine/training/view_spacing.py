"""The angular view spacing of the photos around a box, and the SH learning rate that it allows.

SH of degree 3 vary within about 60 degrees. If the photos are close together, a high SH learning
rate compensates for a short schedule. If they are far apart, no photo constrains the SH between
them, and the same learning rate overfits the photos. Limit and exponent are empirical
(notebook/few_photos.md). Ours; the paper keeps 3DGS's learning rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..model.roi import OrientedBox
from ..model.scene import Float64, PosedImage
from .config import TrainConfig

NEIGHBOUR = 3  # the third one: two photos side by side do not cover the directions around them
EXPONENT = 3.0


def view_directions(images: Sequence[PosedImage], roi: OrientedBox) -> Float64:
    """(V, 3) unit vectors from the box's centre to the photos; zeros for a photo in the centre."""
    rays: Float64 = np.array([image.centre for image in images]).reshape(-1, 3) - roi.centre
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    return rays


def view_spacing(images: Sequence[PosedImage], roi: OrientedBox) -> float:
    """Median angle between a photo and its third neighbour, seen from the box's centre, degrees.

    With fewer than three neighbours, the farthest one counts; 180 for fewer than two photos.
    """
    if len(images) < 2:
        return 180.0
    rays = view_directions(images, roi)
    count = min(NEIGHBOUR, len(rays) - 1)
    chords, _ = cKDTree(rays).query(rays, k=[count + 1])  # the first is the photo itself
    return float(np.median(np.degrees(2 * np.arcsin(np.clip(chords / 2, 0, 1)))))


def with_spaced_rate(config: TrainConfig, spacing: float) -> TrainConfig:
    """The config with the SH learning rate that this spacing allows, at least 3DGS's.

    Args:
        config: of the stage.
        spacing: largest `view_spacing` of its boxes, degrees.
    """
    limit, lr = config.lr_shN_spacing, config.lr_shN
    if limit <= 0 or spacing <= limit:
        return config
    lr *= (limit / spacing) ** EXPONENT
    return replace(config, lr_shN=max(lr, min(config.lr_shN, TrainConfig.lr_shN)))
