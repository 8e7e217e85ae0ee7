"""The pixels of a box stage's mask."""

from __future__ import annotations

import torch
from torch import Tensor

from roigs_engine.training.masks import RoiMask


def pixels_of(mask: RoiMask) -> Tensor:
    """(H, W) bool."""
    width, height = mask.tiles.size
    found = torch.zeros(height, width, dtype=torch.bool)
    x0, y0, x1, y1 = mask.tiles.shown
    found[y0:y1, x0:x1] = mask.weights > 0
    return found
