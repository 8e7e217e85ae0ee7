"""Convex polygons in the image: their hull and their pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .scene import Float64

PIXELS_AT_ONCE = 1 << 20  # of a silhouette: limits the memory of float64 intermediates


def convex_hull(points: Float64) -> Float64:
    """(N, 2) -> (M, 2) corners of the convex hull in order (Andrew's monotone chain).

    Corners that exist only due to rounding are dropped; points on a line give fewer than three.
    """
    order = points[np.lexsort((points[:, 1], points[:, 0]))]
    slack = 1e-14 * float(np.ptp(points, axis=0).max()) ** 2

    def half(walk: Float64) -> list[Float64]:
        chain: list[Float64] = []
        for point in walk:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= slack:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return np.array(half(order) + half(order[::-1])).reshape(-1, 2)


def _turn(a: Float64, b: Float64, c: Float64) -> float:
    """Twice the signed area of the triangle a, b, c."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def fill_convex(polygon: Float64, height: int, width: int) -> NDArray[np.bool_]:
    """(H, W) pixels whose centre lies in a convex polygon (M, 2) of either orientation."""
    mask = np.zeros((height, width), dtype=bool)
    x0, y0 = np.clip(np.floor(polygon.min(axis=0)), 0, (width, height)).astype(int)
    x1, y1 = np.clip(np.ceil(polygon.max(axis=0)), 0, (width, height)).astype(int)
    if x0 >= x1 or y0 >= y1:
        return mask
    following = np.roll(polygon, -1, axis=0)
    signed_area = np.sum(polygon[:, 0] * following[:, 1] - following[:, 0] * polygon[:, 1])
    x, rows = np.arange(x0, x1) + 0.5, max(1, PIXELS_AT_ONCE // (x1 - x0))
    for top in range(y0, y1, rows):
        y = (np.arange(top, min(top + rows, y1)) + 0.5)[:, None]
        inside = mask[top : top + len(y), x0:x1]
        inside[:] = True
        for a, b in zip(polygon, following, strict=True):
            side = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
            inside &= side * np.sign(signed_area) >= 0
    return mask
