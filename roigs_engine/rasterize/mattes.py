"""Mattes: the share of each object in a pixel's alpha, without jagged edges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..formats.frame_requests import RANKS
from ..model.gaussians import SH_C0, Gaussians
from .light import to_linear
from .limits import PICTURE_LIMITS
from .view import rasterize_view

if TYPE_CHECKING:
    from ..model.scene import Camera, Float64

COLOURS = 3
"""Objects per drawing: each gets one colour channel."""


def object_shares(
    drawn: Gaussians, indices: Tensor, alpha: Tensor, camera: Camera, world_to_camera: Float64
) -> dict[int, Tensor]:
    """Return each object's share of a picture's alpha; an object hides those behind it.

    The object with most Gaussians gets the rest. So two to four objects take one drawing more than
    the picture, and one object takes none.

    Args:
        drawn: the picture's N Gaussians.
        indices: (N,) of their objects.
        alpha: (H, W) of the picture.
        camera, world_to_camera: of the picture.

    Returns:
        (H, W) for each index; they add up to `alpha`.
    """
    counts = torch.bincount(indices)
    largest, shares = int(counts.argmax()), dict[int, Tensor]()
    others = [int(index) for index in counts.nonzero() if index != largest]
    for first in range(0, len(others), COLOURS):
        some = others[first : first + COLOURS]
        ours = torch.zeros(len(indices), 1, COLOURS)
        for k, index in enumerate(some):
            ours[:, 0, k] = indices == index
        coloured = replace(drawn, sh=((ours - 0.5) / SH_C0).to(drawn.sh))
        output = rasterize_view(coloured, camera, world_to_camera, limits=PICTURE_LIMITS)
        image = output.image[0].cpu().clamp(0, 1)
        image = to_linear(image) if drawn.target.linear_light else image
        shares |= {index: image[..., k] for k, index in enumerate(some)}
    shares[largest] = (alpha - sum(shares.values(), torch.zeros(()))).clamp(min=0)
    return shares


def ranked(shares: Mapping[int, Tensor]) -> tuple[Tensor, Tensor]:
    """Return the objects with the largest shares in each pixel, and these shares.

    Args:
        shares: (H, W) for at least one index.

    Returns:
        (H, W, RANKS) indices and (H, W, RANKS) shares, the largest first; 0 where there is none.
    """
    order = sorted(shares)
    found = torch.stack([shares[index] for index in order])
    most, which = found.topk(min(RANKS, len(order)), dim=0)
    indices, empty = torch.tensor(order).to(most)[which], most.new_zeros(RANKS, *most.shape[1:])
    indices = torch.where(most > 0, indices, 0)
    filled = [torch.cat([part, empty])[:RANKS].movedim(0, -1) for part in (indices, most)]
    return filled[0], filled[1]
