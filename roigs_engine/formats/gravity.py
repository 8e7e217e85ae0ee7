"""Estimates the direction of gravity in a COLMAP model from its cameras.

People hold cameras level, but point them up and down. So the picture's horizontal axis is level. Up
is the direction that is most nearly at right angles to the photos' x axes (in portraits, their y
axes), for any pitch. If photos look only one way, the mean of the pictures' own up axes is used. It
is off by a few degrees, because most photos look down.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

LEAST_SPAN = 0.05  # directions span a plane if their second eigenvalue is this or more (sum 1)
ROUND = 0.25  # the same for directions all around
LEVEL = 0.04  # directions are in a plane if their least eigenvalue is this or less
CLEAR = 0.5  # length of the mean of unit vectors that mostly agree
WEAK = 0.1  # a shorter mean gives no direction
ERRORS = 3.0  # a model is level if its axis is at most this many standard errors from up,
NEAREST = np.radians(3)  # and at most this angle: with few photos, the errors are large
FEWEST = 3  # photos for an estimate with an error


def gravity_alignment(poses: NDArray[np.float64]) -> Matrix:
    """(3, 3) rotation from the model's frame to one whose z axis points up.

    If one of the model's own axes points up within the error, the model is only turned by right
    angles. It is not turned if that is its z axis.

    Args:
        poses: (N, 4, 4) world_to_camera of the photos, OpenCV axes.
    """
    up, error = up_direction(poses)
    if not up.any():
        return np.eye(3)
    axis = np.zeros(3)
    longest = int(np.abs(up).argmax())
    axis[longest] = np.sign(up[longest])
    if np.arccos(min(1.0, float(up @ axis))) <= min(ERRORS * error, NEAREST):
        up = axis
    return rotation_between(up, np.array([0.0, 0.0, 1.0]))


def up_direction(poses: NDArray[np.float64]) -> tuple[Vector, float]:
    """Up as a unit vector, zero if it is unknown, and its standard error in radians.

    Photos count as portraits only if they look all around, because a pan of portraits looks like a
    tilt of landscapes. Portraits are assumed to be stored as phones do, with their top at the left.
    """
    if len(poses) == 0:
        return np.zeros(3), 0.0
    right, down, forward = (poses[:, row, :3] for row in range(3))
    mean = -down.mean(axis=0)
    length = float(np.linalg.norm(mean))
    landscape = _normal(right, LEAST_SPAN)
    if landscape is not None:
        up, error = landscape
        hint = mean if abs(up @ mean) >= WEAK else -forward.mean(axis=0)  # photos from above
        return _along(up, hint), error
    portrait = _normal(down, ROUND)
    if portrait is not None and length < CLEAR:
        return _along(portrait[0], -right.mean(axis=0)), portrait[1]
    return (mean / length if length > 1e-6 else np.zeros(3)), 0.0


def _normal(sides: Vector, least: float) -> tuple[Vector, float] | None:
    """The normal of the plane that unit vectors (N, 3) lie in, and its standard error.

    None if they are too few, in no plane, or span it less than `least`.
    """
    values, vectors = np.linalg.eigh(sides.T @ sides / len(sides))
    if len(sides) < FEWEST or values[0] > LEVEL or values[1] < least:
        return None
    residual = np.sqrt(max(values[0], 0.0) / len(sides))
    return vectors[:, 0], float(residual * np.sqrt(1 / values[1] + 1 / values[2]))


def _along(direction: Vector, hint: Vector) -> Vector:
    """The direction or its opposite, whichever is nearer to a hint."""
    return direction if direction @ hint >= 0 else -direction


def rotation_between(start: Vector, end: Vector) -> Matrix:
    """The smallest rotation (3, 3) from one unit vector to another."""
    cosine = float(start @ end)
    if cosine < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])  # the vectors are z and -z
    axis = np.cross(start, end)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation: Matrix = np.eye(3) + cross + cross @ cross / (1 + cosine)
    return rotation
