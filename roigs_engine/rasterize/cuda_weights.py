"""Each Gaussian's largest blending weight and their sum, by a pass that gsplat does not offer.

The pass goes through gsplat's own tile lists and blends as `rasterize_to_pixels` does, without
colours: one warp a tile, every Gaussian of its list reduced over the tile's 256 pixels.
"""

from __future__ import annotations

from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor

from .inputs import ALPHA_MAX, ALPHA_MIN, TILE

LAST_LIGHT = 1e-4
"""gsplat: a pixel is done before the Gaussian that would leave less light than this."""


@triton.jit
def _weights(
    means2d,
    conics,
    opacities,
    offsets,
    ids,
    mask,
    pixel_weights,
    largest,
    sums,
    tiles,
    pairs,
    columns,
    width,
    height,
    alpha_min,
    alpha_max,
    last_light,
    SIDE: tl.constexpr,
    MASKED: tl.constexpr,
    LARGEST: tl.constexpr,
    SUMS: tl.constexpr,
    WEIGHTED: tl.constexpr,
) -> Any:
    tile = tl.program_id(0)
    begin = tl.load(offsets + tile)
    end = tl.load(offsets + tile + 1, mask=tile + 1 < tiles, other=pairs)
    if MASKED:
        end = tl.where(tl.load(mask + tile) != 0, end, begin)
    pixel = tl.arange(0, SIDE * SIDE)
    column = (tile % columns) * SIDE + pixel % SIDE
    row = (tile // columns) * SIDE + pixel // SIDE
    inside = (column < width) & (row < height)
    x, y = column.to(tl.float32) + 0.5, row.to(tl.float32) + 0.5
    counts = tl.full((SIDE * SIDE,), 1.0, tl.float32)
    if WEIGHTED:
        counts = tl.load(pixel_weights + row * width + column, mask=inside, other=0.0)
    light = tl.where(inside, 1.0, 0.0)
    open_ = inside.to(tl.int32)  # pixels that are not done
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
        if LARGEST:
            most = tl.max(weight, axis=0)
            if most > tl.load(largest + g):  # most tiles do not raise it: read before the atomic
                tl.atomic_max(largest + g, most)
        if SUMS:
            tl.atomic_add(sums + g, tl.sum(weight * counts, axis=0))
        left = tl.max(open_, axis=0)
        at += 1


def blending_weights(
    means2d: Tensor,  # (N, 2) px
    conics: Tensor,  # (N, 3) inverse covariance: xx, xy, yy
    opacities: Tensor,  # (N,)
    offsets: Tensor,  # (rows, columns) int32, where each tile's list begins
    ids: Tensor,  # (pairs,) int32, Gaussians tile by tile, front to back
    width: int,
    height: int,
    *,
    mask: Tensor | None,  # (rows, columns) bool
    pixel_weights: Tensor | None,  # (height, width)
    largest: Tensor | None,  # (N,) raised to the largest weight
    sums: Tensor | None,  # (N,) added to
) -> None:
    """Adds one picture's weights to `largest` and `sums`, in place."""
    if not len(ids):
        return
    unused = means2d  # where a kernel argument is a pointer that is not read
    _weights[(offsets.numel(),)](
        means2d.contiguous(),
        conics.contiguous(),
        opacities.contiguous(),
        offsets.contiguous(),
        ids,
        unused if mask is None else mask.contiguous(),
        unused if pixel_weights is None else pixel_weights.to(torch.float32).contiguous(),
        unused if largest is None else largest,
        unused if sums is None else sums,
        offsets.numel(),
        len(ids),
        offsets.shape[-1],
        width,
        height,
        ALPHA_MIN,
        ALPHA_MAX,
        LAST_LIGHT,
        SIDE=TILE,
        MASKED=mask is not None,
        LARGEST=largest is not None,
        SUMS=sums is not None,
        WEIGHTED=pixel_weights is not None,
        num_warps=1,
    )
