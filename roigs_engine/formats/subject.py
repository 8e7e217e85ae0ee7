"""What the photos of a model were taken of: where a first box goes.

People aim: the sparse points near the middle of many photos, and close together, are on what they
wanted to show. What that stands on is left out, and what stands beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .standing import standing

Vectors = NDArray[np.float64]
Bounds = tuple[Vectors, Vectors]
"""Lower and upper corner."""

MOST_PHOTOS, MOST_POINTS = 60, 20_000  # more tell no more
FEWEST_POINTS = 10
MIDDLE = 0.4  # how far from the middle a photo shows its subject, in half its shorter side
REACH = 0.3  # of the photos' distance: how far the subject extends from its centre
OUTLIERS = 0.02  # share of the subject's points that is ignored at each side
STRAYS = 0.002  # the same, of what stands apart from all else
FLOATING = 0.005  # share of the points above the subject's foot that is ignored at its top
MARGIN = 1.1  # factor on the size, for what has no points
ROUNDS = 10  # of moving the centre to the middle of the points around it


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A photo's pinhole camera, in pixels, and its (4, 4) world_to_camera, OpenCV axes."""

    pose: Vectors
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


def subject(
    photos: Sequence[View], points: Vectors | NDArray[np.float32], upright: Vectors
) -> Bounds | None:
    """The bounds of what most photos look at; None if photos or points are too few to tell.

    Args:
        photos: in the frame of the model.
        points: (N, 3) in that frame.
        upright: (4, 4) matrix from that frame to the one along whose axes the bounds are.
    """
    if not photos or len(points) < FEWEST_POINTS:
        return None
    chosen = np.random.default_rng(0).permutation(len(points))[:MOST_POINTS]
    model = np.asarray(points, np.float64)[chosen]
    weights = attention(photos[:: -(-len(photos) // MOST_PHOTOS)], model) ** 2
    eyes = np.array([-p.pose[:3, :3].T @ p.pose[:3, 3] for p in photos])
    placed, eyes = _moved(model, upright), _moved(eyes, upright)
    if not weights.any():
        return None
    (centre,) = _quantiles(placed, weights, [0.5])
    near, reach = np.ones(len(placed), bool), 0.0
    for _ in range(ROUNDS):
        reach = REACH * float(np.median(np.linalg.norm(eyes - centre, axis=1)))
        near = (np.linalg.norm(placed - centre, axis=1) <= reach) & (weights > 0)
        if near.sum() < FEWEST_POINTS:
            return None
        (centre,) = _quantiles(placed[near], weights[near], [0.5])
    thing = standing(placed, weights, np.linalg.norm(placed - centre, axis=1), reach)
    if thing is not None and thing[0].sum() >= FEWEST_POINTS:
        low, high = np.quantile(placed[thing[0]], [STRAYS, 1 - STRAYS], axis=0)
        low[2] = thing[1]
        return _with_margin(low, high)
    low, high = _quantiles(placed[near], weights[near], [OUTLIERS, 1 - OUTLIERS])
    high[2] = max(high[2], _top(placed, low, high, reach))
    return _with_margin(low, high)


def _with_margin(low: Vectors, high: Vectors) -> Bounds:
    middle, half = (low + high) / 2, (high - low) / 2 * MARGIN
    return middle - half, middle + half


def _top(points: Vectors, low: Vectors, high: Vectors, reach: float) -> float:
    """How high an object goes whose lower part is within these bounds: nothing floats above it.

    Photos of something tall are often aimed at its foot.
    """
    above = ((points >= low) & (points <= (*high[:2], high[2] + reach))).all(axis=1)
    return float(np.quantile(points[above][:, 2], 1 - FLOATING)) if above.any() else high[2]


def attention(photos: Sequence[View], points: Vectors) -> Vectors:
    """(N,) how near the middle of the photos each point is, on average: from 0 to 1."""
    total = np.zeros(len(points))
    for photo in photos:
        local = points @ photo.pose[:3, :3].T + photo.pose[:3, 3]
        ahead = local[:, 2] > 0
        depth = np.where(ahead, local[:, 2], 1.0)
        x = photo.fx * local[:, 0] / depth + photo.cx - photo.width / 2
        y = photo.fy * local[:, 1] / depth + photo.cy - photo.height / 2
        off = (x**2 + y**2) / (MIDDLE * min(photo.width, photo.height) / 2) ** 2
        total += np.where(ahead, np.exp(-off / 2), 0.0)
    return total / len(photos)


def _moved(points: Vectors, matrix: Vectors) -> Vectors:
    moved: Vectors = points @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def _quantiles(points: Vectors, weights: Vectors, shares: list[float]) -> Vectors:
    """(shares, 3) quantiles of weighted points along each axis."""
    found = []
    for values in points.T:
        order = np.argsort(values)
        total = np.cumsum(weights[order])
        at = np.searchsorted(total, np.array(shares) * total[-1])
        found.append(values[order][np.minimum(at, len(values) - 1)])
    return np.array(found).T
