"""The largest blending weight of each Gaussian, and the sum of its weights; gsplat has neither.

A Triton kernel goes through gsplat's tile lists and blends as `rasterize_to_pixels` does, without
colours: one warp per tile; each Gaussian of the list is reduced over the tile's 256 pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor

from .inputs import ALPHA_MAX, ALPHA_MIN, TILE

LAST_LIGHT = 1e-4
"""gsplat: a pixel stops before the Gaussian that would leave a transmittance below this."""


@dataclass(frozen=True, kw_only=True)
class TileLists:
    """gsplat's lists for an image: the Gaussians of each tile, front to back.

    Attributes:
        offsets: (rows, columns) int32, start of each tile's list.
        ids: (pairs,) int32, the Gaussians, tile by tile.
        mask: (rows, columns) bool, the active tiles; None: all.
        width, height: of the image, px.
    """

    offsets: Tensor
    ids: Tensor
    mask: Tensor | None
    width: int
    height: int


# Triton takes tuples as one argument; FLAGS: masked, largest wanted, sums wanted, pixels weighted.
@triton.jit
def _weights(
    gaussians,  # means2d, conics, opacities
    lists,  # offsets, ids, mask
    results,  # pixel_weights, largest, sums
    sizes,  # tiles, pairs, columns, width, height
    limits,  # smallest and largest alpha, last light
    SIDE: tl.constexpr,
    FLAGS: tl.constexpr,
) -> Any:
    means2d, conics, opacities = gaussians
    offsets, ids, mask = lists
    pixel_weights, largest, sums = results
    tiles, pairs, columns, width, height = sizes
    alpha_min, alpha_max, last_light = limits
    tile = tl.program_id(0)
    begin = tl.load(offsets + tile)
    end = tl.load(offsets + tile + 1, mask=tile + 1 < tiles, other=pairs)
    if FLAGS[0]:
        end = tl.where(tl.load(mask + tile) != 0, end, begin)
    pixel = tl.arange(0, SIDE * SIDE)
    column = (tile % columns) * SIDE + pixel % SIDE
    row = (tile // columns) * SIDE + pixel // SIDE
    inside = (column < width) & (row < height)
    x, y = column.to(tl.float32) + 0.5, row.to(tl.float32) + 0.5
    counts = tl.full((SIDE * SIDE,), 1.0, tl.float32)
    if FLAGS[3]:
        counts = tl.load(pixel_weights + row * width + column, mask=inside, other=0.0)
    light = tl.where(inside, 1.0, 0.0)
    open_ = inside.to(tl.int32)  # pixels that have not stopped
    at = begin
    left = tl.max(open_, axis=0)
    while (at < end) & (left > 0):
        g = tl.load(ids + at).to(tl.int64)
        dx = tl.load(means2d + 2 * g) - x
        dy = tl.load(means2d + 2 * g + 1) - y
        xx = tl.load(conics + 3 * g)
        xy = tl.load(conics + 3 * g + 1)
        yy = tl.load(conics + 3 * g + 2)
        power = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy
        alpha = tl.minimum(alpha_max, tl.load(opacities + g) * tl.exp(-power))
        hit = (open_ > 0) & (power >= 0) & (alpha >= alpha_min)
        after = light * (1 - alpha)
        done = hit & (after <= last_light)
        open_ = tl.where(done, 0, open_)
        hit = hit & ~done
        weight = tl.where(hit, alpha * light, 0.0)
        light = tl.where(hit, after, light)
        if FLAGS[1]:
            most = tl.max(weight, axis=0)
            if most > tl.load(largest + g):  # rarely true: a read is cheaper than an atomic
                tl.atomic_max(largest + g, most)
        if FLAGS[2]:
            tl.atomic_add(sums + g, tl.sum(weight * counts, axis=0))
        left = tl.max(open_, axis=0)
        at += 1


def blending_weights(
    means2d: Tensor,  # (N, 2) px
    conics: Tensor,  # (N, 3) inverse covariance: xx, xy, yy
    opacities: Tensor,  # (N,)
    lists: TileLists,
    *,
    pixel_weights: Tensor | None,  # (height, width)
    largest: Tensor | None,  # (N,) raised to the largest weight
    sums: Tensor | None,  # (N,) added to
) -> None:
    """Add one image's weights to `largest` and `sums`, in place."""
    if not len(lists.ids):
        return
    offsets, mask = lists.offsets, lists.mask
    unused = means2d  # a valid pointer for kernel arguments that are not read
    weights = unused if pixel_weights is None else pixel_weights.to(torch.float32).contiguous()
    _weights[(offsets.numel(),)](
        (means2d.contiguous(), conics.contiguous(), opacities.contiguous()),
        (offsets.contiguous(), lists.ids, unused if mask is None else mask.contiguous()),
        (weights, unused if largest is None else largest, unused if sums is None else sums),
        (offsets.numel(), len(lists.ids), offsets.shape[-1], lists.width, lists.height),
        (ALPHA_MIN, ALPHA_MAX, LAST_LIGHT),
        SIDE=TILE,
        FLAGS=(mask is not None, largest is not None, sums is not None, pixel_weights is not None),
        num_warps=1,
    )
