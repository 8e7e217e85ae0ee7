"""Draws a thumbnail of a coloured object from points on its surface. Numpy only, no bpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

TURN, TILT = np.radians(30.0), np.radians(20.0)
"""The view: from the right of the front, and from above."""
MARGIN = 0.06
"""Margin, as a share of the picture's side."""


def points_on(corners: Float32, count: int, seed: int = 0) -> tuple[NDArray[np.int64], Float32]:
    """Sample points uniformly on triangles (T, 3, 3).

    Returns the triangle of each point (N,), and the weights of its corners (N, 3).
    """
    sides = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).astype(np.float64)
    if not areas.sum() > 0:
        return np.zeros(0, np.int64), np.zeros((0, 3), np.float32)
    random = np.random.default_rng(seed)
    faces = random.choice(len(corners), count, p=areas / areas.sum())
    a, b = random.random((2, count))
    over = a + b > 1
    a, b = np.where(over, 1 - a, a), np.where(over, 1 - b, b)
    return faces, np.stack([1 - a - b, a, b], axis=-1).astype(np.float32)


def picture(places: Float32, colours: Float32, side: int) -> Float32:
    """(side, side, 4) picture of points, top row first; empty pixels are transparent.

    Args:
        places: (N, 3), z up.
        colours: (N, 3), in the picture's colour space.
        side: pixels.
    """
    found = np.zeros((side, side, 4), np.float32)
    if not len(places):
        return found
    c, s = np.cos(TURN), np.sin(TURN)
    right = places @ (c, s, 0.0)
    away = places @ (-s, c, 0.0)
    high = np.cos(TILT) * places[:, 2] + np.sin(TILT) * away
    depth = np.cos(TILT) * away - np.sin(TILT) * places[:, 2]
    large = max(float(np.ptp(right)), float(np.ptp(high)), 1e-12)
    scale = side * (1 - 2 * MARGIN) / large
    x = (right - (right.max() + right.min()) / 2) * scale + side / 2
    y = side / 2 - (high - (high.max() + high.min()) / 2) * scale
    order = np.argsort(-depth, kind="stable")  # the nearest is written last
    rows, columns = (v[order].astype(int).clip(0, side - 1) for v in (y, x))
    found[rows, columns, :3] = colours[order]
    found[rows, columns, 3] = 1
    return found
