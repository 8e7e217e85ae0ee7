"""Oriented boxes in the COLMAP frame. No bpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..shared import rois
from .frames import Matrix, nearest_rotation


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """An oriented box in the COLMAP frame, as in `rois.json` (docs/files.md)."""

    world_to_box: Matrix
    half_extents: NDArray[np.float64]

    @classmethod
    def of(cls, record: rois.RoiRecord) -> Box:
        """Return the box of a file's record."""
        return cls(world_to_box=record.world_to_box, half_extents=record.half_extents)

    def record(self, name: str) -> rois.RoiRecord:
        """Return the box as a file's record."""
        return rois.RoiRecord(
            name=name, world_to_box=self.world_to_box, half_extents=self.half_extents
        )

    def is_at(self, world_to_box: Any, half_extents: Any) -> bool:
        """Whether the box has this place and size up to rounding; values may be damaged."""
        size = float(np.max(self.half_extents))
        try:
            return bool(
                np.allclose(self.world_to_box, world_to_box, atol=1e-4 * max(size, 1.0))
                and np.allclose(self.half_extents, half_extents, rtol=1e-4)
            )
        except (ValueError, TypeError, OverflowError):  # no numbers
            return False

    def contains(self, points: NDArray[np.float32]) -> NDArray[np.bool_]:
        """(N,) which of the points (N, 3) lie inside."""
        local = points @ self.world_to_box[:3, :3].T.astype(np.float32)
        local += self.world_to_box[:3, 3].astype(np.float32)
        return np.asarray((np.abs(local) <= self.half_extents.astype(np.float32)).all(axis=1))


class ShearedBoxError(ValueError):
    """The sides of the box are no longer at right angles."""


def box_from_matrix(empty: Matrix, root: Matrix, half_size: float) -> Box:
    """Return the box of a cube empty.

    Args:
        empty: the empty's `matrix_world`.
        root: `matrix_world` of the root, the parent of the COLMAP model.
        half_size: the empty's display size, half the cube's side.

    Raises:
        ShearedBoxError: the axes are not at right angles, as after scaling the root unevenly.
        ValueError: the box has no volume.
    """
    if not (np.isfinite(empty).all() and np.isfinite(root).all()):
        raise ValueError("it has no volume")
    local = np.linalg.inv(root) @ empty
    sides = np.linalg.norm(local[:3, :3], axis=0)
    if (sides * half_size < 1e-12).any():
        raise ValueError("it has no volume")
    axes = local[:3, :3] / sides
    if np.abs(axes.T @ axes - np.eye(3)).max() > 1e-3:
        raise ShearedBoxError("its sides are not at right angles")
    rotation = nearest_rotation(axes)
    world_to_box = np.eye(4)
    world_to_box[:3, :3] = rotation.T
    world_to_box[:3, 3] = -rotation.T @ local[:3, 3]
    return Box(world_to_box=world_to_box, half_extents=sides * half_size)
