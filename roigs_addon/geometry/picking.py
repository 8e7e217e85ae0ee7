"""Finds the point under the mouse. Numpy only, no bpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .frames import Matrix

REACHES = (4.0, 14.0)  # pixels from the mouse; the larger one if no point is within the smaller
SLACK = 4.0  # a point counts as in front up to this many reaches behind the nearest one


@dataclass(frozen=True, eq=False)
class Sight:
    """A view of the 3D viewport.

    Attributes:
        view: (4, 4) world -> camera, OpenGL's axes.
        projection: (4, 4) camera -> clip space.
        size: width and height in pixels.
    """

    view: Matrix
    projection: Matrix
    size: tuple[int, int]

    @property
    def perspective(self) -> bool:
        """Whether it is a perspective view."""
        return bool(self.projection[3, 3] == 0)

    def depths(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """(N,) depths along the viewing axis."""
        return np.asarray(-(points @ self.view[2, :3] + self.view[2, 3]), float)

    def pixels(self, points: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """(N, 2) pixels from the lower left corner, and (N,) which are between the clip planes."""
        matrix = self.projection @ self.view
        with np.errstate(all="ignore"):  # points at the eye
            weights = points @ matrix[3, :3] + matrix[3, 3]
            clip = [points @ matrix[row, :3] + matrix[row, 3] for row in range(3)]
            sides = (
                (0.5 + 0.5 * clip[axis] / weights) * size for axis, size in enumerate(self.size)
            )
            placed = np.stack(tuple(sides), axis=1)
            return placed, np.asarray(np.abs(clip[2]) <= weights)

    def pixels_per_unit(self, depths: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) pixels that a length of 1 covers at these depths."""
        focal = self.projection[0, 0] * self.size[0] / 2
        with np.errstate(all="ignore"):
            return np.asarray(focal / depths if self.perspective else np.full(len(depths), focal))


def under(points: NDArray[Any], sight: Sight, at: tuple[float, float]) -> int | None:
    """Return the clicked point: of points in front near the mouse, the nearest to the mouse.

    Args:
        points: (N, 3) in the world.
        sight: the view.
        at: the mouse, in pixels from the lower left corner.
    """
    placed, between = sight.pixels(points)
    with np.errstate(all="ignore"):
        away = np.hypot(*(placed - at).T)
        near = np.flatnonzero((away <= REACHES[1]) & between)
    if not len(near):
        return None
    reach = REACHES[0] if away[near].min() <= REACHES[0] else REACHES[1]
    near = near[away[near] <= reach]
    depths = sight.depths(points[near])
    focal = sight.projection[0, 0] * sight.size[0] / 2
    deep = depths.min() + SLACK * reach * (depths.min() if sight.perspective else 1.0) / focal
    front = near[depths <= deep]
    return int(front[np.argmin(away[front])])
