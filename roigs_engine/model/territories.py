"""Territories: which of several models of one scene owns a position.

Each sparse point of the scene belongs to one territory; a position belongs to that of most of the
sparse points nearest to it. So every position has exactly one owner, on surfaces and in the air,
and the border between two territories runs where the points say, not along an endless plane. A
position inside a box belongs to the box's territory: no border cuts a box.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .ownership import nearest_owner
from .roi import OrientedBox
from .scene import Float64, Int64

if TYPE_CHECKING:
    from .gaussians import Gaussians

NEIGHBOURS = 8  # sparse points that vote on a position
AT_ONCE = 100_000  # positions, so that voting takes little memory


@dataclass(frozen=True, kw_only=True, eq=False)
class Territories:
    """The territories of a scene's models.

    Attributes:
        points: (P, 3) sparse points, world units.
        owner: (P,) the territory of each, from 0.
        rois: the boxes.
        roi_owner: the territory of each box.
    """

    points: Float64
    owner: Int64
    rois: tuple[OrientedBox, ...]
    roi_owner: tuple[int, ...]

    @cached_property
    def digest(self) -> str:
        """Hash of all that decides who owns what; the boxes' names do not."""
        digest = hashlib.sha256(self.points.tobytes() + self.owner.tobytes())
        for roi, owner in zip(self.rois, self.roi_owner, strict=True):
            digest.update(roi.world_to_box.tobytes() + roi.half_extents.tobytes())
            digest.update(str(owner).encode())
        return digest.hexdigest()

    def owners(self, positions: Float64) -> Int64:
        """(N, 3) world positions -> (N,) the territory that owns each; 0 for NaN and Inf."""
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
        """(N, 3) finite positions -> (N,) the territory of most of the nearest points."""
        count = min(NEIGHBOURS, len(self.points))
        _, near = self._tree.query(positions, k=list(range(1, count + 1)))
        labels = self.owner[near]
        votes = np.zeros((len(positions), int(self.owner.max(initial=0)) + 1))
        rows = np.arange(len(positions))
        for rank in range(count):  # a tie goes to the nearer points
            votes[rows, labels[:, rank]] += 1 + 0.5**rank / count
        return np.asarray(votes.argmax(axis=1), dtype=np.int64)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree  # Blender's Python, which reads plans, may lack scipy

        return cKDTree(self.points)


def joined(models: Iterable[Gaussians], territories: Territories) -> Gaussians:
    """One model: of each territory's model, the Gaussians whose centre the territory owns.

    Args:
        models: one for each territory, in their order; needed one at a time.
        territories: computed on the CPU, so that all devices give the same owners.

    Returns:
        On the models' device.
    """
    import torch

    from .gaussians import Gaussians

    parts = []
    for index, model in enumerate(models):
        centres = model.means.detach().cpu().double().numpy()
        rows = torch.from_numpy(territories.owners(centres) == index)
        parts.append(model.rows(rows.to(model.means.device)))
    return Gaussians.concatenate(parts)
