"""The pixels of a box stage's mask."""

from __future__ import annotations

import torch
from torch import Tensor

from roigs_engine.rasterize.inputs import TILE
from roigs_engine.training.loss_masks import LossMask


def pixels_of(mask: LossMask) -> Tensor:
    """(H, W) bool."""
    (width, height), (left, top, _, _) = mask.tiles.size, mask.tiles.rectangle
    grid = mask.tiles.mask
    assert grid is not None
    found = torch.zeros(height, width, dtype=torch.bool)
    for row, column in grid.nonzero().tolist():
        y, x = (top + row) * TILE, (left + column) * TILE
        found[y : y + TILE, x : x + TILE] = True
    return found
