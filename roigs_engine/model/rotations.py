"""Quaternions to rotation matrices."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from torch import Tensor

T = TypeVar("T")


def rotation_entries(w: T, x: T, y: T, z: T) -> list[T]:
    """The nine entries of the rotation matrix of a unit quaternion wxyz, row by row.

    Works for numbers, arrays and tensors.
    """
    a: Any
    b: Any
    c: Any
    d: Any
    a, b, c, d = w, x, y, z
    return [
        1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c),
        2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b),
        2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c),
    ]  # fmt: skip


def rotation_matrices(quats: Tensor) -> Tensor:
    """(N, 4) unit quaternions wxyz -> (N, 3, 3)."""
    import torch

    return torch.stack(rotation_entries(*quats.unbind(-1)), dim=-1).reshape(-1, 3, 3)
