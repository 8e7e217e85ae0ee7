"""Finds the Gaussians under a brush, and the visible ones among them. Numpy only, no bpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .picking import Sight

Mask = NDArray[np.bool_]

CELL = 8  # pixels: side of the cells in which the front Gaussians are found
OPAQUE = 0.5
"""Gaussians are hidden if less than this share of the light comes through nearer ones."""
THICK = 3.0  # a Gaussian belongs to the front up to this many of its sizes behind it


def below(
    places: NDArray[Any], seen: Mask, circles: Sequence[tuple[float, float]], radius: float
) -> Mask:
    """(N,) which points lie in one of the circles.

    Args:
        places: (N, 2) in pixels.
        seen: (N,) which points are in the view.
        circles: centres, in pixels.
        radius: of all of them.
    """
    found = np.zeros(len(places), bool)
    with np.errstate(all="ignore"):
        for centre in circles:
            near = seen & (np.abs(places - centre) <= radius).all(axis=1)
            rows = np.flatnonzero(near)
            found[rows[np.hypot(*(places[rows] - centre).T) <= radius]] = True
    return found


def in_front(
    points: NDArray[Any], sizes: NDArray[Any], opacities: NDArray[Any], sight: Sight
) -> Mask:
    """(N,) which Gaussians are visible because nearer ones let enough light through.

    Args:
        points: (N, 3) in the world.
        sizes: (N,) mean standard deviation in the world.
        opacities: (N,) 0 to 1.
        sight: the view.
    """
    found = np.zeros(len(points), bool)
    places, between = sight.pixels(points)
    with np.errstate(all="ignore"):
        inside = between & (places >= 0).all(axis=1) & (places < sight.size).all(axis=1)
    rows = np.flatnonzero(inside)
    if not len(rows):
        return found
    depths = sight.depths(points[rows])
    across = sizes[rows] * sight.pixels_per_unit(depths)
    covered = np.minimum(2 * np.pi * across**2 / CELL**2, 1.0)  # share of a cell
    column, line = (places[rows] // CELL).astype(np.int64).T
    cell = line * (sight.size[0] // CELL + 1) + column
    order = np.lexsort((depths, cell))
    begins = np.flatnonzero(np.diff(cell[order], prepend=-1))
    length = np.diff(begins, append=len(order))
    through = np.cumsum(np.log1p(-np.minimum(opacities[rows][order] * covered[order], 0.999)))
    before = np.concatenate(([0.0], through[begins[1:] - 1]))
    hidden = through - np.repeat(before, length) <= np.log(OPAQUE)
    front = np.minimum.reduceat(np.where(hidden, depths[order], np.inf), begins)
    near = depths[order] <= np.repeat(front, length) + THICK * sizes[rows][order]
    found[rows[order]] = near
    return found
