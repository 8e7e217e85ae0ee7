"""Which way is up in a COLMAP model, whose axes are arbitrary. Numpy only, no bpy.

People hold cameras level, but point them up and down. So the side of the picture is horizontal:
up is the direction to which the photos' x axes (their y axes, in portraits) are most nearly at
right angles, whatever their pitch. The mean of the pictures' own up axes, which is used where
photos look only one way, is off by a few degrees: it leans to where most photos look down.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .frames import Matrix

Vector = NDArray[np.float64]

SPREAD = 0.05  # least eigenvalue, of 1 in sum, of directions that span a plane
ERRORS = 3.0  # a model is level if its axis is this many standard errors from up, or nearer
FEWEST = 3  # photos for an estimate with an error


def levelled(poses: NDArray[np.float64]) -> Matrix:
    """(3, 3) rotation from the model's frame to one whose z axis points up.

    A model whose own axis points up, as far as the photos tell, is only turned by right angles, or
    not at all if that is its z axis.

    Args:
        poses: (N, 4, 4) world_to_camera of the photos, OpenCV axes.
    """
    up, error = up_and_error(poses)
    if not up.any():
        return np.eye(3)
    axis = np.zeros(3)
    longest = int(np.abs(up).argmax())
    axis[longest] = np.sign(up[longest])
    if np.arccos(min(1.0, float(up @ axis))) <= ERRORS * error:
        up = axis
    return _turning(up, np.array([0.0, 0.0, 1.0]))


def up_and_error(poses: NDArray[np.float64]) -> tuple[Vector, float]:
    """Up as a unit vector, zero if nothing tells, and its standard error in radians."""
    right, down, forward = (poses[:, row, :3].reshape(-1, 3) for row in range(3))
    mean = -down.sum(axis=0)
    best: tuple[Vector, float] | None = None
    for sides, hint in ((right, mean), (down, -forward.sum(axis=0))):  # landscape, portrait
        values, vectors = np.linalg.eigh(sides.T @ sides / max(len(sides), 1))
        if len(sides) < FEWEST or values[1] < SPREAD:
            continue
        up = vectors[:, 0] * (1.0 if vectors[:, 0] @ hint >= 0 else -1.0)
        residual = np.sqrt(max(values[0], 0.0) / len(sides))
        error = float(residual * np.sqrt(1 / values[1] + 1 / values[2]))
        if best is None or error < best[1]:
            best = up, error
    if best is not None:
        return best
    length = float(np.linalg.norm(mean))
    if length < 1e-6 * max(len(down), 1):
        return np.zeros(3), 0.0
    return mean / length, 0.0


def _turning(start: Vector, end: Vector) -> Matrix:
    """The smallest rotation (3, 3) from one unit vector to another."""
    cosine = float(start @ end)
    if cosine < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])  # the vectors are z and -z
    axis = np.cross(start, end)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation: Matrix = np.eye(3) + cross + cross @ cross / (1 + cosine)
    return rotation
