"""Scores a set of photos: point density x voxel occupancy inside the box.

After ActiveInitSplat (arXiv 2503.06859); its exact formula is unpublished. For the photos S:

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
    offset = (roi.to_box(points) + 1) * roi.half_extents  # 0 to the side length, per axis
    cells = np.ceil(2 * roi.half_extents / edge - 1e-9).clip(1).astype(np.int64)
    cell = np.clip(np.floor(offset / edge).astype(np.int64), 0, cells - 1)
    flat = np.ravel_multi_index((cell[:, 0], cell[:, 1], cell[:, 2]), tuple(cells.tolist()))
    return np.asarray(np.unique(flat, return_inverse=True)[1].reshape(-1).astype(np.int64))


class _Unseen:
    """The items (points or voxels) that no photo of a growing set S shows yet.

    The total time of all additions is linear in the number of pairs of a photo and a shown item.
    """

    def __init__(self, view: Int64, thing: Int64, views: int, things: int) -> None:
        """Args: `view`, `thing`: (N,) pairs of photo and item, each once, ascending by photo."""
        self._thing, self._view_of = thing, view[np.argsort(thing, kind="stable")]
        self._starts = np.searchsorted(view, np.arange(views + 1))
        self._viewers = np.concatenate([[0], np.cumsum(np.bincount(thing, minlength=things))])
        self.clear()

    def clear(self) -> None:
        """Make S empty."""
        self.gains = np.diff(self._starts)  # (V,) number of items that each photo adds
        self.seen = np.zeros(len(self._viewers) - 1, dtype=bool)  # (T,)

    def add(self, view: int) -> None:
        """Add a photo to S."""
        things = self._thing[self._starts[view] : self._starts[view + 1]]
        new = things[~self.seen[things]]
        self.seen[new] = True
        for start, end in zip(self._viewers[new], self._viewers[new + 1], strict=True):
            self.gains[self._view_of[start:end]] -= 1


class DensityOccupancy:
    """f(S) for a growing set S of photos, and the gain of each photo.

    Counts are integers, so equal gains are exactly equal.
    """

    def __init__(self, candidates: Candidates, context: Context = QUIET) -> None:
        """`context` is not used: nothing here takes long."""
        view, point = candidates.obs_view, candidates.obs_point
        voxel = voxel_indices(candidates.points, candidates.roi)
        voxels = int(voxel.max()) + 1
        pairs = np.unique(view * voxels + voxel[point])
        self._points = _Unseen(view, point, len(candidates), len(candidates.points))
        self._voxels = _Unseen(pairs // voxels, pairs % voxels, len(candidates), voxels)
        self.clear()

    def clear(self) -> None:
        """Make S empty."""
        self._points.clear()
        self._voxels.clear()
        self._counts = 0, 0  # numbers of seen points and voxels

    @property
    def product(self) -> int:
        """Seen points x seen voxels of S: f(S) times a constant, exact."""
        return self._counts[0] * self._counts[1]

    @property
    def value(self) -> float:
        """f(S), 0 to 1."""
        return self.product / (len(self._points.seen) * len(self._voxels.seen))

    def product_with(self, view: int) -> int:
        """`product` of S with that photo."""
        points, voxels = self._counts
        return int((points + self._points.gains[view]) * (voxels + self._voxels.gains[view]))

    def gains(self) -> Float64:
        """(V,) f(S + v) - f(S) for every photo v (0 for those in S)."""
        points, voxels = self._counts
        products: Float64 = (points + self._points.gains) * (voxels + self._voxels.gains)
        return (products - self.product) / (len(self._points.seen) * len(self._voxels.seen))

    def add(self, view: int) -> None:
        """Add a photo to S."""
        points, voxels = self._counts
        new = int(self._points.gains[view]), int(self._voxels.gains[view])
        self._counts = points + new[0], voxels + new[1]
        self._points.add(view)
        self._voxels.add(view)


class Score(Protocol):
    """The score of a growing set of photos, 0 to 1."""

    @property
    def value(self) -> float: ...
    def add(self, view: int) -> None: ...
    def clear(self) -> None: ...


def prefix_values(score: Score, order: Sequence[int]) -> tuple[float, ...]:
    """The score after each photo of `order`; the set must be empty."""
    values = []
    for view in order:
        score.add(view)
        values.append(score.value)
    return tuple(values)
