"""Finds the support of a captured object, if the box has a thin plate of it. Numpy only, no bpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LOWEST = 0.25
"""Lowest share of the height, in which a plate is sought."""
UPRIGHT = 0.8
"""Least cosine between the normals of a plate's faces and up."""
LAYER = 0.01
"""Thickness of a plate, with its waves and the transition to the foot, as a share of the height."""
WIDE = 0.9
"""Least extent of a plate along both axes, as a share of the mesh's."""
BELOW = 0.05
"""Largest share of the area under a plate: its edge."""


def top_of(corners: NDArray[np.float32]) -> float | None:
    """Return the height at which a cut removes the plate below an object; None without a plate.

    Args:
        corners: (T, 3, 3) of triangles, z up.
    """
    if not len(corners):
        return None
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(crosses, axis=1) / 2
    flat, middles = corners.reshape(-1, 3), corners.mean(axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    layer = LAYER * (high[2] - low[2])
    upward = crosses[:, 2] > UPRIGHT * 2 * np.maximum(areas, 1e-20)
    found = upward & (middles[:, 2] < low[2] + LOWEST * (high[2] - low[2]))
    if not found.any() or not layer > 0:
        return None
    heights = ((middles[found, 2] - low[2]) / layer).astype(int)
    peak = low[2] + (np.bincount(heights, areas[found]).argmax() + 0.5) * layer
    plate = found & (np.abs(middles[:, 2] - peak) < 1.5 * layer)
    reach = np.ptp(corners[plate].reshape(-1, 3), axis=0) / np.maximum(high - low, 1e-20)
    under = areas[middles[:, 2] < peak - 1.5 * layer].sum()
    if (reach[:2] < WIDE).any() or under > BELOW * areas.sum():
        return None
    return float(peak + 1.5 * layer)
