"""Score of a set of photos: point density x voxel occupancy inside the box.

After ActiveInitSplat (arXiv 2503.06859), whose exact formula is unpublished. For the photos S:

    D(S) = points of the box seen by S / points of the box
    O(S) = voxels holding a point seen by S / voxels holding a point of the box
    f(S) = D(S) O(S)

Voxels are cubes, 16 along the box's longest side. (If D were points per *occupied* voxel, D O would
only count points.) D and O are coverage functions; f is not submodular, log f is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..context import QUIET, Context
from ..model.roi import OrientedBox
from ..model.scene import Float64, Int64
from ..model.visibility import Candidates

VOXELS_ALONG_LONGEST_SIDE = 16


def voxel_indices(points: Float64, roi: OrientedBox) -> Int64:
    """(P, 3) points in the box -> (P,) voxel of each, 0..n-1 over the n occupied voxels."""
    edge = 2 * roi.half_extents.max() / VOXELS_ALONG_LONGEST_SIDE
    offset = (roi.to_box(points) + 1) * roi.half_extents  # 0 .. side, per axis
    cells = np.ceil(2 * roi.half_extents / edge - 1e-9).clip(1).astype(np.int64)
    cell = np.clip(np.floor(offset / edge).astype(np.int64), 0, cells - 1)
    flat = np.ravel_multi_index((cell[:, 0], cell[:, 1], cell[:, 2]), tuple(cells.tolist()))
    return np.asarray(np.unique(flat, return_inverse=True)[1].reshape(-1).astype(np.int64))


class DensityOccupancy:
    """f(S) of a growing set S of photos, and the gain of each photo.

    Counts are integers, so equal gains are exactly equal.
    """

    def __init__(self, candidates: Candidates, context: Context = QUIET) -> None:
        """Nothing here takes so long that `context` is asked."""
        voxel = voxel_indices(candidates.points, candidates.roi)
        self._views = len(candidates)
        self._starts = candidates.row_starts()
        self._view, self._point = candidates.obs_view, candidates.obs_point
        voxels = int(voxel.max()) + 1
        pairs = np.unique(self._view * voxels + voxel[self._point])
        self._voxel_view, self._view_voxel = pairs // voxels, pairs % voxels
        self._voxel_starts = np.searchsorted(self._voxel_view, np.arange(self._views + 1))
        self._new_point = np.ones(len(candidates.points), dtype=bool)
        self._new_voxel = np.ones(voxels, dtype=bool)
        self._points = self._voxels = 0

    @property
    def product(self) -> int:
        """Seen points x seen voxels of S: f(S) times a constant, exact."""
        return self._points * self._voxels

    @property
    def value(self) -> float:
        """f(S), 0 to 1."""
        return self.product / (len(self._new_point) * len(self._new_voxel))

    def product_with(self, view: int) -> int:
        """`product` of S and that photo."""
        points = self._point[self._starts[view] : self._starts[view + 1]]
        voxels = self._view_voxel[self._voxel_starts[view] : self._voxel_starts[view + 1]]
        added_points = int(np.count_nonzero(self._new_point[points]))
        added_voxels = int(np.count_nonzero(self._new_voxel[voxels]))
        return (self._points + added_points) * (self._voxels + added_voxels)

    def gains(self) -> Float64:
        """(V,) f(S + v) - f(S) for every photo v (0 for those in S)."""
        points = np.bincount(
            self._view, weights=self._new_point[self._point], minlength=self._views
        )
        voxels = np.bincount(
            self._voxel_view, weights=self._new_voxel[self._view_voxel], minlength=self._views
        )
        products = (self._points + points) * (self._voxels + voxels)  # integers, exact in float64
        return (products - self.product) / (len(self._new_point) * len(self._new_voxel))

    def add(self, view: int) -> None:
        """Add a photo to S."""
        points = self._point[self._starts[view] : self._starts[view + 1]]
        self._points += int(np.count_nonzero(self._new_point[points]))
        self._new_point[points] = False
        voxels = self._view_voxel[self._voxel_starts[view] : self._voxel_starts[view + 1]]
        self._voxels += int(np.count_nonzero(self._new_voxel[voxels]))
        self._new_voxel[voxels] = False


class Score(Protocol):
    """The score of a growing set of photos, 0 to 1."""

    @property
    def value(self) -> float: ...
    def add(self, view: int) -> None: ...


def prefix_values(score: Score, order: Sequence[int]) -> tuple[float, ...]:
    """The score after each photo of `order`; the set must be empty."""
    values = []
    for view in order:
        score.add(view)
        values.append(score.value)
    return tuple(values)
