"""Lists of models and where they stand, as JSON has them (docs/files.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ..model.scene import Float64

HINT = "docs/files.md describes requests."


def placed_models(record: Any) -> list[tuple[str, Float64]]:
    """PLY and matrix of each model of a record's `models`.

    Raises:
        KeyError, TypeError, ValueError, OverflowError: it is malformed.
    """
    wanted = [(str(item["ply"]), _affine(item["matrix"])) for item in record["models"]]
    if not wanted:
        raise ValueError("it has no model")
    return wanted


def _affine(rows: Any) -> Float64:
    """A matrix of a request; ValueError unless it can be inverted."""
    matrix = np.array(rows, dtype=float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError("matrix must be 4 x 4 finite numbers")
    if (matrix[3] != (0, 0, 0, 1)).any() or np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise ValueError("matrix must be affine, and no scale may be zero")
    return matrix
