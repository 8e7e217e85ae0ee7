"""Gaussians after a movement: turned, scaled, sheared, with their view-dependent colours."""

from __future__ import annotations

import numpy as np

from ..formats.drawable import usable
from ..model.gaussians import Gaussians
from ..model.scene import Float64
from ..rasterize.instances import Instance
from .arrays import Arrays, flaw
from .merged import merged

FLATTEST = 1e-9  # least determinant of a matrix, of 1 for the same size in all directions


def moved(arrays: Arrays, matrix: Float64) -> Arrays:
    """Gaussians after a (4, 4) matrix; bit for bit the same if that changes nothing.

    Raises:
        ValueError: the arrays do not belong together, or the matrix flattens them.
    """
    if (matrix == np.eye(4)).all():
        return arrays
    if problem := flaw(arrays):
        raise ValueError(problem)
    linear = matrix[:3, :3]
    if not np.isfinite(matrix).all() or (matrix[3] != (0, 0, 0, 1)).any():
        raise ValueError("its transform is none of space")
    if abs(np.linalg.det(linear)) <= FLATTEST * np.linalg.norm(linear, axis=0).prod():
        raise ValueError("its transform flattens the Gaussians")
    arrays = usable(arrays)
    if not len(arrays["means"]):
        return arrays
    gaussians, frame = Gaussians.framed(arrays)
    model, frame = merged([Instance(gaussians=gaussians, frame=frame, matrix=matrix)])
    return model.arrays(frame)
