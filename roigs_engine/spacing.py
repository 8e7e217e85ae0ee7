"""How far apart the photos stand around a box, and how fast to learn view dependence there.

Harmonics of the third degree turn within some 60 degrees. Where photos stand close, a high rate for
them only makes up for a short schedule; where they stand far apart, nothing holds the harmonics
between them, and the same rate learns the photos by heart. Limit and exponent are empirical
(docs/results.md); ours, the paper keeps 3DGS's rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from .config import TrainConfig
from .roi import OrientedBox
from .scene import PosedImage

NEIGHBOUR = 3  # two photos side by side do not make a surrounding
EXPONENT = 3.0


def photo_spacing(images: Sequence[PosedImage], roi: OrientedBox) -> float:
    """Degrees from a photo to its third neighbour as seen from the box's centre, the median.

    With fewer neighbours the last counts; 180 for less than two photos.
    """
    rays = np.array([image.centre for image in images]).reshape(-1, 3) - roi.centre
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    if len(rays) < 2:
        return 180.0
    count = min(NEIGHBOUR, len(rays) - 1)
    chords, _ = cKDTree(rays).query(rays, k=[count + 1])  # the first is the photo itself
    return float(np.median(np.degrees(2 * np.arcsin(np.clip(chords / 2, 0, 1)))))


def rates_for_spacing(config: TrainConfig, degrees: float) -> TrainConfig:
    """The config with the harmonics' rate that photos so far apart allow, 3DGS's at least."""
    limit = config.lr_shN_spacing
    if not 0 < limit < degrees:
        return config
    least = min(config.lr_shN, TrainConfig.lr_shN)
    rate = config.lr_shN * (limit / degrees) ** EXPONENT
    return replace(config, lr_shN=max(rate, least))
