"""Which points are of the one object that photos were aimed at, of those on a table or a floor.

What it stands on is the plane that most points lie in; above it, things stand apart.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]
Mask = NDArray[np.bool_]

FARTHER = 2.0  # times the reach
ROUNDS, JUDGES = 400, 4000  # planes that are tried, and points that judge them at most
LEVEL = np.cos(np.radians(20))  # of the normal to up: more is a wall or a roof
THICK = 0.02  # of the reach: how far points of the plane are from it
CLEAR = 0.03  # of the reach: higher is above the plane
FEWEST = 0.25  # of the points: a plane with fewer is none
BELOW = 0.25  # of its points: a plane with more below it is not what things stand on
CELL = 1 / 12  # of the reach: two things with an empty cell between them are two
SPARSE = 0.05  # of the usual number around a point: with fewer it is between things
MOST = 6  # things that are looked at


def standing(
    points: Vectors, weights: Vectors, away: Vectors, reach: float
) -> tuple[Mask, float] | None:
    """The points of the thing that gets most attention, and the height of what it stands on.

    Args:
        points: (N, 3), z up.
        weights: (N,) attention.
        away: (N,) distance from the middle of attention.
        reach: how far from there the plane is looked for; the thing may extend FARTHER.

    Returns:
        Mask and height; None if nothing stands on a plane.
    """
    near = away <= reach
    plane = support(points[near], THICK * reach)
    if plane is None:
        return None
    height = points @ plane[:3] - plane[3]
    above, below = height > CLEAR * reach, height < -CLEAR * reach
    if (below & near).sum() > BELOW * (near & ~above & ~below).sum():
        return None
    above &= away <= FARTHER * reach
    thing = _together(points[above], weights[above], CELL * reach)
    if thing is None:
        return None
    mask = np.zeros(len(points), bool)
    mask[np.flatnonzero(above)[thing]] = True
    middle = np.median(points[mask], axis=0)
    return mask, float((plane[3] - plane[:2] @ middle[:2]) / plane[2])


def support(points: Vectors, thick: float) -> Vectors | None:
    """The level plane that most points lie in, by RANSAC: (normal, offset); None: there is none."""
    random = np.random.default_rng(0)
    judges = points[random.permutation(len(points))[:JUDGES]]
    corners = judges[random.integers(0, len(judges), (ROUNDS, 3))]
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
    if len(inside) < max(3, FEWEST * len(judges)):
        return None
    centre = inside.mean(axis=0)
    normal = np.linalg.svd(inside - centre, full_matrices=False)[2][2]
    normal *= 1 if normal[2] > 0 else -1
    return np.append(normal, normal @ centre) if normal[2] >= LEVEL else None


def _together(points: Vectors, weights: Vectors, cell: float) -> NDArray[np.intp] | None:
    """Indices of the points of the thing with most attention; None if there are too few."""
    if not len(points):
        return None
    cells = ((points - points.min(axis=0)) / cell).astype(int) + 1
    counts = np.zeros(cells.max(axis=0) + 2)
    np.add.at(counts, tuple(cells.T), 1)
    around = _around(counts)
    usual = np.median(around[tuple(cells.T)])
    filled = (counts > 0) & (around >= max(2.0, SPARSE * usual))
    attention = np.zeros_like(counts)
    np.add.at(attention, tuple(cells.T), weights)
    left, best, most = np.where(filled, attention, 0.0), np.zeros_like(filled), 0.0
    for _ in range(MOST):
        if not left.any():
            break
        thing = np.zeros_like(filled)
        thing[np.unravel_index(int(left.argmax()), left.shape)] = True
        while True:
            grown = filled & (_around(thing) > 0)
            if (grown == thing).all():
                break
            thing = grown
        if (total := float(left[thing].sum())) > most:
            best, most = thing, total
        left[thing] = 0.0
    return np.flatnonzero(best[tuple(cells.T)])


def _around(values: Vectors | Mask) -> Vectors:
    """The sum of each cell and those around it."""
    shifts = product((-1, 0, 1), repeat=3)
    return np.asarray(sum(np.roll(values.astype(float), s, axis=(0, 1, 2)) for s in shifts))
