"""Finds solid and free space from the rays between photos and their observed points.

It uses a grid as in robotics (occupancy mapping; Moravec and Elfes 1985). Each ray passes through
air and ends at something solid. A cell is solid if at least as many rays end in it as pass through
it. It is air if rays pass and fewer end. The other cells are unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..model.roi import OrientedBox
from ..model.scene import Float64, Int64, SfmScene
from ..model.visibility import observed_points
from ..selection.coverage import nearest_neighbours

Bools = NDArray[np.bool_]

CELLS_ALONG_DIAGONAL = 12  # of the box; objects that hide a part of it are larger than a cell
MOST_CELLS = 1 << 22
MOST_RAYS = 1 << 17
NEIGHBOURS, MOST = 5, 75.0  # points, the point included; percentile over the points
SKIPPED = 1.75  # cells skipped at the start of a ray, about a cell's diagonal: the surface itself


@dataclass(frozen=True, kw_only=True, eq=False)
class Space:
    """A grid over the cameras and the box.

    Attributes:
        low: (3,) corner of the grid, world units.
        cell: side of a cell, world units.
        solid, air: (X, Y, Z) whether cells are solid, or air.
    """

    low: Float64
    cell: float
    solid: Bools
    air: Bools

    @classmethod
    def of(
        cls, scene: SfmScene, roi: OrientedBox, context: Context = QUIET, *, coarse: bool = False
    ) -> Space:
        """Compute the grid from the tracks, or from projections if there are none.

        Args:
            coarse: make cells as large as the gaps between points, so that walls have no holes.
        """
        centres = scene.centres()
        usual = float(np.median(np.linalg.norm(centres - roi.centre, axis=1)))
        around = roi.centre + usual * np.array([[-1.0], [1.0]])  # where photos may be taken
        corners = np.concatenate([centres, roi.corners(), around])
        cell = roi.diagonal / CELLS_ALONG_DIAGONAL
        cell = max(cell, _gap(scene.points, context)) if coarse else cell
        low, high = corners.min(axis=0), corners.max(axis=0)
        span = np.maximum(high - low, cell)
        cell = max(cell, float(np.cbrt(span.prod() / MOST_CELLS)))
        low = low - 2 * cell
        shape = tuple(int(n) for n in np.ceil((high + 2 * cell - low) / cell))
        ends, passed = np.zeros(shape), np.zeros(shape)
        grid = cls(low=low, cell=cell, solid=ends > 0, air=ends > 0)
        found = observed_points(scene, context)
        step = max(1, -(-sum(len(rows) for rows in found) // MOST_RAYS))
        for image, rows in zip(scene.images, found, strict=True):
            context.check_cancelled()
            grid._cast(image.centre, scene.points[rows[::step]], ends, passed)
        solid = (ends > 0) & (ends >= passed)
        return cls(low=low, cell=cell, solid=solid, air=(passed > 0) & ~solid)

    def _cast(self, eye: Float64, points: Float64, ends: Float64, passed: Float64) -> None:
        """Count rays from a camera to points (N, 3) in the cells where they end or pass."""
        points = points[np.isfinite(points).all(axis=1)]
        ways = points - eye
        lengths = np.linalg.norm(ways, axis=1)
        # One sample per cell length. Samples end before the cells of the surface around the point.
        counts = np.floor(lengths / self.cell - SKIPPED).clip(0).astype(int)
        most = int(counts.max(initial=0))
        most = min(most, int(np.ceil(np.linalg.norm(np.array(self.solid.shape)))))
        steps = np.arange(most)
        unit = ways / np.maximum(lengths, 1e-300)[:, None]
        for start in range(0, len(points), 4096):
            part = slice(start, start + 4096)
            places = eye + unit[part, None] * (steps[None, :, None] * self.cell)
            cells, inside = self._cells(places)
            use = inside & (steps[None] < counts[part, None])
            passed += np.bincount(cells[use], minlength=passed.size).reshape(passed.shape)
        cells, inside = self._cells(points)
        ends += np.bincount(cells[inside], minlength=ends.size).reshape(ends.shape)

    def _cells(self, places: Float64) -> tuple[Int64, Bools]:
        """(..., 3) places -> (...) flat cell index, 0 outside; and whether inside the grid."""
        index = np.floor((places - self.low) / self.cell)
        shape = np.array(self.solid.shape)
        inside = ((index >= 0) & (index < shape)).all(axis=-1)
        index = np.where(inside[..., None], index, 0).astype(np.int64)
        flat = (index[..., 0] * shape[1] + index[..., 1]) * shape[2] + index[..., 2]
        return np.asarray(flat), np.asarray(inside)

    def is_free(self, places: Float64) -> Bools:
        """(N, 3) places -> (N,) whether their cells and the adjacent ones are not solid."""
        cells, inside = self._cells(places)
        return np.asarray(inside & ~_grown(self.solid).reshape(-1)[cells])

    def passed(self, places: Float64) -> Bools:
        """(N, 3) places -> (N,) whether each is in a cell of air."""
        cells, inside = self._cells(places)
        return np.asarray(inside & self.air.reshape(-1)[cells])

    def hidden(self, places: Float64, eye: Float64, skipped: float = SKIPPED) -> Bools:
        """(P, 3) places -> (P,) whether something solid is between each and the eye (3,).

        The first `skipped` cells do not count: they are the surface that a place is on.
        """
        ways = eye - places
        lengths = np.linalg.norm(ways, axis=1)
        counts = np.floor(lengths / self.cell - 1).clip(0).astype(int)
        steps = np.arange(skipped, max(skipped + 1, int(counts.max(initial=0)) + 1))
        unit = ways / np.maximum(lengths, 1e-300)[:, None]
        cells, inside = self._cells(
            places[:, None] + unit[:, None] * steps[None, :, None] * self.cell
        )
        use = inside & (steps[None] < counts[:, None])
        return np.asarray((self.solid.reshape(-1)[cells] & use).any(axis=1))


def _gap(points: Float64, context: Context) -> float:
    """Gap between points: twice the distance to a point's `NEIGHBOURS`-th, for most points."""
    points = points[np.isfinite(points).all(axis=1)]
    count = min(NEIGHBOURS, len(points))
    if count < 2:
        return 0.0
    near = points[nearest_neighbours(points, count, context)]
    away = np.linalg.norm(near - points[:, None], axis=2).max(axis=1)
    return float(2 * np.percentile(away, MOST))


def _grown(cells: Bools) -> Bools:
    """The cells, and all cells that touch one."""
    grown = cells.copy()
    for axis in range(3):
        before = grown.copy()
        forward, back = [slice(None)] * 3, [slice(None)] * 3
        forward[axis], back[axis] = slice(1, None), slice(None, -1)
        grown[tuple(forward)] |= before[tuple(back)]
        grown[tuple(back)] |= before[tuple(forward)]
    return grown
