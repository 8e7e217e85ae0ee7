"""Finds the main object of the photos, as the first box; numpy only.

People aim at the object. So sparse points that are near the middle of many photos, and close
together, are on it. The support plane (a table, the floor) is the level plane with most of these
points. It is left out, and so are other objects on the same plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]
Mask = NDArray[np.bool_]
Bounds = tuple[Vectors, Vectors]
"""Lower and upper corner of a box."""

MOST_PHOTOS, MOST_POINTS = 60, 20_000  # more do not change the result
FEWEST_POINTS = 10
MIDDLE = 0.4  # width of the weights around a photo's middle, in half its shorter side
REACH = 0.3  # how far the object extends from its centre, in units of the photos' distance
OUTLIERS = 0.02  # share of the object's points that is ignored at each side
STRAYS = 0.002  # the same for an object separated from its support plane
FLOATING = 0.005  # share of the points above the object's foot that is ignored at its top
MARGIN = 1.1  # factor on the size: some parts of the object have no points
ROUNDS = 10  # how often the centre is moved to the middle of the points around it

# Search for the support plane and for the objects on it.
FARTHER = 2.0  # times the reach
PLANES, JUDGES = 400, 4000  # planes tried, and points that they are tested on at most
LEVEL = np.cos(np.radians(20))  # least cosine of normal and up; below it is a wall or a roof
THICK = 0.02  # of the reach: largest distance of the plane's points from it
CLEAR = 0.03  # of the reach: points higher than this are above the plane
PLANE_SHARE = 0.25  # of the points: a plane needs at least this share
BELOW = 0.25  # of the plane's points: with more points below it, it is not a support
CELL = 1 / 12  # of the reach: size of a cell; an empty cell separates two objects
SPARSE = 0.05  # of the median number around a point: sparser cells separate objects, too
OBJECTS = 6  # clusters compared at most


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


def foreground_bounds(
    photos: Sequence[View], points: Vectors | NDArray[np.float32], alignment: Vectors
) -> Bounds | None:
    """Find the bounds of the object in most photos; None with too few photos or points.

    Args:
        photos: in the frame of the model.
        points: (N, 3) in that frame.
        alignment: (4, 4) from that frame to one with z up; the bounds are along its axes.
    """
    if not photos or len(points) < FEWEST_POINTS:
        return None
    chosen = np.random.default_rng(0).permutation(len(points))[:MOST_POINTS]
    model = np.asarray(points, np.float64)[chosen]
    weights = attention(photos[:: -(-len(photos) // MOST_PHOTOS)], model) ** 2
    eyes = np.array([-p.pose[:3, :3].T @ p.pose[:3, 3] for p in photos])
    aligned, eyes = _moved(model, alignment), _moved(eyes, alignment)
    if not weights.any():
        return None
    (centre,) = _quantiles(aligned, weights, [0.5])
    near, reach = np.ones(len(aligned), bool), 0.0
    for _ in range(ROUNDS):
        reach = REACH * float(np.median(np.linalg.norm(eyes - centre, axis=1)))
        near = (np.linalg.norm(aligned - centre, axis=1) <= reach) & (weights > 0)
        if near.sum() < FEWEST_POINTS:
            return None
        (centre,) = _quantiles(aligned[near], weights[near], [0.5])
    found = above_support_plane(aligned, weights, np.linalg.norm(aligned - centre, axis=1), reach)
    if found is not None and found[0].sum() >= FEWEST_POINTS:
        low, high = np.quantile(aligned[found[0]], [STRAYS, 1 - STRAYS], axis=0)
        low[2] = found[1]
    else:
        low, high = _quantiles(aligned[near], weights[near], [OUTLIERS, 1 - OUTLIERS])
        high[2] = max(high[2], _top(aligned, low, high, reach))
    middle, half = (low + high) / 2, (high - low) / 2 * MARGIN
    return middle - half, middle + half


def _top(points: Vectors, low: Vectors, high: Vectors, reach: float) -> float:
    """The top of an object whose lower part is within these bounds.

    Photos of a tall object are often aimed at its foot. All points above are taken as its own,
    because nothing floats above it.
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


def above_support_plane(
    points: Vectors, weights: Vectors, away: Vectors, reach: float
) -> tuple[Mask, float] | None:
    """The points of the object with most attention, and the height of its support plane.

    Args:
        points: (N, 3), z up.
        weights: (N,) attention.
        away: (N,) distance from the middle of attention.
        reach: radius in which the plane is searched; the object may extend FARTHER times that.

    Returns:
        Mask (N,) and height; None if nothing stands on a plane.
    """
    near = away <= reach
    plane = support_plane(points[near], THICK * reach)
    if plane is None:
        return None
    height = points @ plane[:3] - plane[3]
    above, below = height > CLEAR * reach, height < -CLEAR * reach
    if (below & near).sum() > BELOW * (near & ~above & ~below).sum():
        return None
    above &= away <= FARTHER * reach
    cluster = _main_cluster(points[above], weights[above], CELL * reach)
    if cluster is None:
        return None
    mask = np.zeros(len(points), bool)
    mask[np.flatnonzero(above)[cluster]] = True
    middle = np.median(points[mask], axis=0)
    return mask, float((plane[3] - plane[:2] @ middle[:2]) / plane[2])


def support_plane(points: Vectors, thick: float) -> Vectors | None:
    """Find the level plane with most points, by RANSAC: (normal, offset); None: there is none."""
    random = np.random.default_rng(0)
    judges = points[random.permutation(len(points))[:JUDGES]]
    corners = judges[random.integers(0, len(judges), (PLANES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals *= np.where(normals[:, 2] < 0, -1, 1)[:, None] / np.maximum(lengths, 1e-300)[:, None]
    good = normals[:, 2] >= LEVEL
    normals, offsets = normals[good], np.einsum("nk,nk->n", normals, corners[:, 0])[good]
    if not len(normals):
        return None
    near = np.abs(judges @ normals.T - offsets) <= thick
    best = int(near.sum(axis=0).argmax())
    inside = judges[near[:, best]]
    if len(inside) < max(3, PLANE_SHARE * len(judges)):
        return None
    centre = inside.mean(axis=0)
    normal = np.linalg.svd(inside - centre, full_matrices=False)[2][2]
    normal *= 1 if normal[2] > 0 else -1
    return np.append(normal, normal @ centre) if normal[2] >= LEVEL else None


def _main_cluster(points: Vectors, weights: Vectors, cell: float) -> NDArray[np.intp] | None:
    """Rows of the connected points with most attention; None if there are no points."""
    if not len(points):
        return None
    cells = ((points - points.min(axis=0)) / cell).astype(int) + 1
    counts = np.zeros(cells.max(axis=0) + 2)
    np.add.at(counts, tuple(cells.T), 1)
    around = _around(counts)
    usual = np.median(around[tuple(cells.T)])
    filled = (counts > 0) & (around >= max(2.0, SPARSE * usual))
    weight = np.zeros_like(counts)
    np.add.at(weight, tuple(cells.T), weights)
    left, best, most = np.where(filled, weight, 0.0), np.zeros_like(filled), 0.0
    for _ in range(OBJECTS):
        if not left.any():
            break
        cluster = np.zeros_like(filled)
        cluster[np.unravel_index(int(left.argmax()), left.shape)] = True
        while True:
            grown = filled & (_around(cluster) > 0)
            if (grown == cluster).all():
                break
            cluster = grown
        if (total := float(left[cluster].sum())) > most:
            best, most = cluster, total
        left[cluster] = 0.0
    return np.flatnonzero(best[tuple(cells.T)])


def _around(values: Vectors | Mask) -> Vectors:
    """The sum of each cell and those around it."""
    shifts = product((-1, 0, 1), repeat=3)
    return np.asarray(sum(np.roll(values.astype(float), s, axis=(0, 1, 2)) for s in shifts))
