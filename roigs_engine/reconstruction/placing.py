"""Where a new model is put: upright, its floor at z = 0, its subject at the origin, a usual size.

Photos alone tell no direction, place or scale. Numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..formats.gravity import Matrix, Vector, gravity_alignment

DISTANCE = 2.0  # from the cameras to what they see, in units of the scene; a guess at metres
LAYERS = 200  # of the height, in the search for the floor
FLOOR = 3.0  # times the points of the median layer that has any: a layer with more is a floor
LOWEST = 0.02  # share of the points below the floor, where no layer stands out


@dataclass(frozen=True, kw_only=True)
class Placement:
    """A similarity: scale * rotation @ x + translation."""

    scale: float
    rotation: Matrix
    translation: Vector


def placement(poses: Matrix, points: Matrix, distance: float) -> Placement:
    """Where a model is put.

    Args:
        poses: (N, 4, 4) world_to_camera of the photos.
        points: (M, 3), at least one.
        distance: median distance of the points from the cameras that observe them.
    """
    scale = DISTANCE / distance if distance > 0 else 1.0
    rotation = gravity_alignment(poses)
    placed = scale * points @ rotation.T
    eyes = np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in poses])
    heights = scale * eyes @ rotation[2]
    centre = np.append(np.median(placed[:, :2], axis=0), floor(placed[:, 2], float(max(heights))))
    return Placement(scale=scale, rotation=rotation, translation=-centre)


def floor(heights: Vector, top: float) -> float:
    """The height of the floor: the lowest layer with many points, below the highest camera.

    Args:
        heights: of the points.
        top: of the highest camera.
    """
    low, high = np.quantile(heights, (LOWEST / 2, 1 - LOWEST / 2))
    counts, edges = np.histogram(heights, bins=LAYERS, range=(low, min(high, max(top, low))))
    filled = counts[counts > 0]
    if len(filled):
        many = counts >= max(FLOOR * np.median(filled), 0.5 * counts.max())
        if many.any():
            layer = int(np.argmax(many))
            inside = (heights >= edges[layer]) & (heights <= edges[layer + 1])
            if inside.any():
                return float(np.median(heights[inside]))
    return float(np.quantile(heights, LOWEST))
