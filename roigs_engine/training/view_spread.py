"""The angular spread of the photos around a box, and the opacity decay outside boxes that fits it.

Opacity decay (`opacity_decay.py`) takes away what only some directions of view do not see through.
Photos from one side have no other directions. There, decay gains little, and outside the boxes it
fades plain surroundings: one step in three can give back what they lose. Ours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from .config import TrainConfig
from .view_spacing import view_directions


def view_spread(images: Sequence[PosedImage], roi: OrientedBox) -> float:
    """How far the photos spread around their mean direction, seen from the box's centre, degrees.

    It is the angle whose cosine is the length of the mean of the directions' unit vectors: 0 if all
    photos are in one direction, 90 if they are all around. A ring of photos at an elevation of 30
    degrees has 60, a third of that ring 30. 0 without photos.
    """
    if not images:
        return 0.0
    length = float(np.linalg.norm(view_directions(images, roi).mean(axis=0)))
    return math.degrees(math.acos(min(1.0, length)))


def with_spared_outside(config: TrainConfig, spread: float) -> TrainConfig:
    """The config with less opacity decay outside the boxes if the photos are from one side.

    What is left is the share of whole photos: what is outside decays as often as these come round.

    Args:
        config: of the stage.
        spread: largest `view_spread` of its boxes, degrees.
    """
    limit = config.outside_spared_spread
    config = replace(config, outside_spared_spread=0.0)  # or stages that it spares nothing change
    if spread >= limit or not config.opacity_decay:
        return config
    return replace(config, outside_spared=max(config.outside_spared, 1 - 1 / config.full_every))
