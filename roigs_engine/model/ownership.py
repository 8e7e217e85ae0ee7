"""Ownership of positions and Gaussians: by boxes, and by the models of a scene trained in cells.

A box owns the positions inside it. If boxes overlap, the owner is the box with the nearest centre,
with distances in units of each box's half extents. A scene that several models share is partitioned
by its sparse points, so every position has exactly one owner (docs/method.md, "Blocks and groups").
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .roi import OrientedBox
from .scene import Float64, Int64

if TYPE_CHECKING:
    from torch import Tensor

    from .gaussians import Gaussians


def nearest_owner(points: Float64, rois: Sequence[OrientedBox]) -> NDArray[np.int64]:
    """(N, 3) world positions -> (N,) index of the box that owns each, -1 for none."""
    owner = np.full(len(points), -1, dtype=np.int64)
    best = np.full(len(points), np.inf)
    for index, roi in enumerate(rois):
        local = roi.to_box(points)
        with np.errstate(all="ignore"):
            distance = np.linalg.norm(local, axis=1)
        mine = (np.abs(local) <= 1).all(axis=1) & (distance < best)
        owner[mine], best[mine] = index, distance[mine]
    return owner


def owners(gaussians: Gaussians, rois: Sequence[OrientedBox]) -> Tensor:
    """(N,) index of the box that owns each Gaussian's centre, -1 for none; on the model's device.

    Always computed on the CPU, so that all devices give the same owners.
    """
    import torch

    centres = gaussians.means.detach().cpu().double().numpy()
    return torch.from_numpy(nearest_owner(centres, rois)).to(gaussians.means.device)


def count_owned(gaussians: Gaussians, rois: Sequence[OrientedBox]) -> list[int]:
    """The number of Gaussians that each box owns."""
    owner = owners(gaussians, rois)
    return [int((owner == index).sum()) for index in range(len(rois))]


NEIGHBOURS = 8  # sparse points that vote on a position
AT_ONCE = 100_000  # positions voted on at a time, to limit memory


@dataclass(frozen=True, kw_only=True, eq=False)
class Partition:
    """A partition of space among a scene's models.

    Attributes:
        points: (P, 3) sparse points, world units.
        owner: (P,) the model of each, from 0.
        rois, roi_owner: the boxes, and the model of each.
    """

    points: Float64
    owner: Int64
    rois: tuple[OrientedBox, ...]
    roi_owner: tuple[int, ...]

    @cached_property
    def digest(self) -> str:
        """Hash of everything that decides ownership; without the boxes' names."""
        digest = hashlib.sha256(self.points.tobytes() + self.owner.tobytes())
        for roi, owner in zip(self.rois, self.roi_owner, strict=True):
            digest.update(roi.world_to_box.tobytes() + roi.half_extents.tobytes())
            digest.update(str(owner).encode())
        return digest.hexdigest()

    def owners(self, positions: Float64) -> Int64:
        """(N, 3) world positions -> (N,) the model that owns each; 0 for NaN and Inf."""
        found = np.zeros(len(positions), dtype=np.int64)
        good = np.flatnonzero(np.isfinite(positions).all(axis=1))
        for start in range(0, len(good), AT_ONCE):
            rows = good[start : start + AT_ONCE]
            found[rows] = self._voted(positions[rows])
        box = nearest_owner(positions, self.rois)
        boxed = box >= 0
        found[boxed] = np.array(self.roi_owner, dtype=np.int64)[box[boxed]]
        return found

    def _voted(self, positions: Float64) -> Int64:
        """(N, 3) finite positions -> (N,) the model that most of the nearest points belong to."""
        count = min(NEIGHBOURS, len(self.points))
        _, near = self._tree.query(positions, k=list(range(1, count + 1)))
        labels = self.owner[near]
        votes = np.zeros((len(positions), int(self.owner.max(initial=0)) + 1))
        rows = np.arange(len(positions))
        for rank in range(count):  # in a tie, the nearer points win
            votes[rows, labels[:, rank]] += 1 + 0.5**rank / count
        return np.asarray(votes.argmax(axis=1), dtype=np.int64)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree  # here, because Blender's Python may lack scipy

        return cKDTree(self.points)


def joined(models: Iterable[Gaussians], partition: Partition) -> Gaussians:
    """Join models: from each, take the Gaussians whose centre it owns; on the models' device.

    `models` are in the partition's order; they are needed one at a time. Owners are computed on the
    CPU, so that all devices give the same result.
    """
    import torch

    from .gaussians import Gaussians

    parts = []
    for index, model in enumerate(models):
        centres = model.means.detach().cpu().double().numpy()
        rows = torch.from_numpy(partition.owners(centres) == index)
        parts.append(model.rows(rows.to(model.means.device)))
    return Gaussians.concatenate(parts)
