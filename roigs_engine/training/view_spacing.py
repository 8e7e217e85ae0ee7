"""The angular view spacing of the photos around a box, and the SH learning rate that it allows.

SH of degree 3 vary within about 60 degrees. If the photos are close together, a high SH learning
rate compensates for a short schedule. If they are far apart, no photo constrains the SH between
them, and the same learning rate overfits the photos. This happens early if all photos are far
apart. If only the close-ups are, it happens late, in a long stage: the other photos constrain the
colours, but not the detail. Limits and exponent are empirical (docs/lab_notebook.md). Ours; the
paper keeps 3DGS's learning rate.
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
MIN_SCALE = 0.7  # of a photo's pixels per world unit: half as many pixels on the box
STEPS = 3000  # longest stage with the full learning rate if the close-ups are far apart


def view_spacing(images: Sequence[PosedImage], roi: OrientedBox) -> float:
    """Median angle between a photo and its third neighbour, seen from the box's centre, degrees.

    With fewer than three neighbours, the farthest one counts; 180 for fewer than two photos.
    """
    if len(images) < 2:
        return 180.0
    rays, _ = _rays(images, roi)
    count = min(NEIGHBOUR, len(rays) - 1)
    chords, _ = cKDTree(rays).query(rays, k=[count + 1])  # the first is the photo itself
    return float(np.median(np.degrees(2 * np.arcsin(np.clip(chords / 2, 0, 1)))))


def detail_spacing(images: Sequence[PosedImage], roi: OrientedBox) -> float:
    """As `view_spacing`, for the detail that close-ups show, degrees.

    Only photos that show the box about as large or larger are neighbours of a photo, and the median
    weights each photo by its pixels on the box.
    """
    if len(images) < 2:
        return 180.0
    rays, distances = _rays(images, roi)
    scales = np.array([image.camera.fx for image in images]) / distances
    angles = np.degrees(np.arccos(np.clip(rays @ rays.T, -1, 1)))
    angles[scales[None] < MIN_SCALE * scales[:, None]] = 180.0
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
    """The config with the SH learning rate that this spacing allows, at least 3DGS's.

    Args:
        config: of the stage.
        spacing, detail: largest `view_spacing` and `detail_spacing` of its boxes, degrees.
    """
    limit, lr = config.lr_shN_spacing, config.lr_shN
    if limit <= 0:
        return config
    if spacing > limit:
        lr *= (limit / spacing) ** EXPONENT
    if detail > limit:
        lr = min(lr, config.lr_shN * STEPS / max(config.steps, STEPS))
    return replace(config, lr_shN=max(lr, min(config.lr_shN, TrainConfig.lr_shN)))
