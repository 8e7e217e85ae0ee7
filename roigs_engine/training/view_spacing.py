"""How far apart the photos stand around a box, and how fast to learn view dependence there.

Harmonics of the third degree turn within some 60 degrees. Where photos stand close, a high rate for
them only makes up for a short schedule; where they stand far apart, nothing holds the harmonics
between them, and the same rate learns the photos by heart. That happens sooner where all photos are
far apart, and later, in a long stage, where only the close-ups are: the others hold the colours,
but not the detail. Limits and exponent are empirical (docs/results.md); ours, the paper keeps
3DGS's rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..model.roi import OrientedBox
from ..model.scene import Float64, PosedImage
from .config import TrainConfig

NEIGHBOUR = 3  # two photos side by side do not make a surrounding
EXPONENT = 3.0
AS_CLOSE = 0.7  # of a photo's pixels per world unit: half of its pixels on the box
STEPS = 3000  # that close-ups far apart allow the full rate for


def view_spacing(images: Sequence[PosedImage], roi: OrientedBox) -> float:
    """Degrees from a photo to its third neighbour as seen from the box's centre, the median.

    With fewer neighbours the last counts; 180 for less than two photos.
    """
    if len(images) < 2:
        return 180.0
    rays, _ = _rays(images, roi)
    count = min(NEIGHBOUR, len(rays) - 1)
    chords, _ = cKDTree(rays).query(rays, k=[count + 1])  # the first is the photo itself
    return float(np.median(np.degrees(2 * np.arcsin(np.clip(chords / 2, 0, 1)))))


def detail_spacing(images: Sequence[PosedImage], roi: OrientedBox) -> float:
    """The same for what the closest photos show: a mean pixel of the box instead of a mean photo.

    Neighbours are photos that show the box about as large or larger; photos count by their pixels.
    """
    if len(images) < 2:
        return 180.0
    rays, distances = _rays(images, roi)
    scales = np.array([image.camera.fx for image in images]) / distances
    angles = np.degrees(np.arccos(np.clip(rays @ rays.T, -1, 1)))
    angles[scales[None] < AS_CLOSE * scales[:, None]] = 180.0
    np.fill_diagonal(angles, 0.0)
    angles.sort(axis=1)
    thirds = angles[:, min(NEIGHBOUR, len(images) - 1)]
    order = np.argsort(thirds, kind="stable")
    pixels = np.array([roi.projected_pixels(i.camera, i.world_to_camera) for i in images])
    share = np.cumsum(pixels[order])
    return float(thirds[order][np.searchsorted(share, share[-1] / 2)])


def _rays(images: Sequence[PosedImage], roi: OrientedBox) -> tuple[Float64, Float64]:
    """(N, 3) unit vectors from the box's centre to the photos, and (N,) their distances."""
    rays = np.array([image.centre for image in images]) - roi.centre
    distances = np.maximum(np.linalg.norm(rays, axis=1), 1e-12)
    return rays / distances[:, None], distances


def learning_rates_for_spacing(config: TrainConfig, spacing: float, detail: float) -> TrainConfig:
    """The config with the harmonics' rate that photos so far apart allow, 3DGS's at least.

    Args:
        config: of the stage.
        spacing, detail: of its sparsest box, degrees: `view_spacing`, `detail_spacing`.
    """
    limit, rate = config.lr_shN_spacing, config.lr_shN
    if limit <= 0:
        return config
    if spacing > limit:
        rate *= (limit / spacing) ** EXPONENT
    if detail > limit:
        rate = min(rate, config.lr_shN * STEPS / max(config.steps, STEPS))
    return replace(config, lr_shN=max(rate, min(config.lr_shN, TrainConfig.lr_shN)))
