"""Quaternions to rotation matrices."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor


def rotation_entries(w: Any, x: Any, y: Any, z: Any) -> list[Any]:
    """The nine entries of the rotation matrix of a unit quaternion wxyz, row by row.

    Works for numbers, arrays and tensors.
    """
    return [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip


def rotation_matrices(quats: Tensor) -> Tensor:
    """(N, 4) unit quaternions wxyz -> (N, 3, 3)."""
    import torch

    return torch.stack(rotation_entries(*quats.unbind(-1)), dim=-1).reshape(-1, 3, 3)
