"""The order of Gaussians in memory: along a Z-order curve."""

from __future__ import annotations

import torch
from torch import Tensor


def morton_order(means: Tensor) -> Tensor:
    """(N, 3) positions -> (N,) row numbers along a Z-order curve.

    Neighbours in space become neighbours in memory, which is good for the kernels' caches. Each
    axis has 10 bits between its 1st and 99th percentile, so that a few distant Gaussians do not
    reduce the resolution.
    """
    points = means.detach().double()
    if len(points) == 0:
        return torch.zeros(0, dtype=torch.int64, device=means.device)
    low, high = _percentile(points, 0.01), _percentile(points, 0.99)
    unit = ((points - low) / (high - low).clamp(min=1e-12)).clamp(0, 1)
    cell = (unit * 1023).long()
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cell = (cell | (cell << shift)) & mask
    code = cell[:, 0] | (cell[:, 1] << 1) | (cell[:, 2] << 2)
    return torch.argsort(code, stable=True)


def _percentile(points: Tensor, share: float) -> Tensor:
    """(N, 3) -> (3,) quantile of each column at `share` (0 to 1), linearly interpolated."""
    position = share * (len(points) - 1)
    lower, upper = (
        points.kthvalue(int(k) + 1, dim=0).values for k in (position, -(-position // 1))
    )
    return lower + (upper - lower) * (position % 1)
