"""Places a scene: floor at z = 0, size, origin. Numpy only, no bpy.

`levelling`, `scaling` and `centring` return a (4, 4) matrix that is applied to the world.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..shared import gravity
from .frames import Matrix

Vector = NDArray[np.float64]

ON_A_LINE = 0.01  # points narrower than this share of their length define no plane
MOST, TRIES = 2000, 300  # points, and planes through three of them, in the search for a plane
INSIDE = 2.5  # standard errors from a plane up to which a point belongs to it
LEVEL = 0.05  # cameras nearer to a plane than this share of their extent are beside it
ASKEW = 20.0  # degrees of a floor from level; cameras measure it to 5, ramps have 15, stairs 30
ON_FLOOR = 0.1  # a box nearer to the floor than this share of its height stands on it


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane: the mean of the points it was fitted to, and its normal."""

    point: Vector
    normal: Vector


def plane_through(points: Vector) -> Plane | None:
    """Fit a plane to most of (N, 3) points; None if they are fewer than 3, on a line, or NaN."""
    if len(points) < 3 or not np.isfinite(points).all():
        return None
    if len(points) > 3:
        points = points[_near_one_plane(points)]
    middle = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - middle, full_matrices=False)
    if not sizes[1] > ON_A_LINE * sizes[0]:
        return None
    return Plane(middle, axes[2])


def _near_one_plane(points: Vector) -> NDArray[np.bool_]:
    """(N,) which points are near the plane with the least median distance from the points."""
    random = np.random.default_rng(0)
    some = points[random.permutation(len(points))[:MOST]]
    threes = some[random.integers(0, len(some), (TRIES, 3))]
    normals = np.cross(threes[:, 1] - threes[:, 0], threes[:, 2] - threes[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    good = lengths > 0
    if not good.any():
        return np.ones(len(points), bool)
    normals, origins = normals[good] / lengths[good, None], threes[good, 0]
    offsets = np.abs(some @ normals.T - (origins * normals).sum(axis=1))
    medians = np.median(offsets, axis=0)
    best = int(np.argmin(medians))
    usual = 1.4826 * float(medians[best]) * (1 + 5 / max(len(some) - 3, 1))  # Rousseeuw 1987
    away = np.abs((points - origins[best]) @ normals[best])
    return np.asarray(away <= max(INSIDE * usual, 1e-6 * float(np.ptp(points, axis=0).max())))


def levelling(plane: Plane, eyes: Vector, *, flip: bool = False) -> Matrix:
    """Return the motion that levels a plane at z = 0; the middle of its points keeps x and y.

    Args:
        plane: the floor.
        eyes: (V, 3) of cameras, which are above it; if they are beside it, the world's up decides.
        flip: turn it over.
    """
    normal = plane.normal
    heights = (eyes - plane.point) @ normal
    above = float(np.median(heights)) if len(eyes) else 0.0
    spread = float(np.ptp(eyes, axis=0).max()) if len(eyes) else 0.0
    if abs(above) <= LEVEL * spread:
        above = float(normal[2])
    if (above < 0) != flip:
        normal = -normal
    matrix = np.eye(4)
    matrix[:3, :3] = gravity.rotation_between(normal, np.array([0.0, 0.0, 1.0]))
    matrix[:3, 3] = (*plane.point[:2], 0.0) - matrix[:3, :3] @ plane.point
    return matrix


def scaling(first: Vector, second: Vector, length: float) -> Matrix | None:
    """Return the scaling about the origin that gives two points this distance.

    None if they are one point, or not finite.
    """
    apart = float(np.linalg.norm(second - first))
    if not 0 < apart < np.inf:
        return None
    factor = length / apart
    return np.diag([factor, factor, factor, 1.0])


def turn_of(matrix: Matrix) -> float:
    """Return the angle of a rotation in degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(matrix[:3, :3]) - 1) / 2, -1, 1))))


def askew(matrix: Matrix, poses: Matrix) -> float:
    """Return the angle between the z axis and the cameras' up after a rotation, in degrees.

    Args:
        matrix: the rotation.
        poses: (V, 4, 4) world_to_camera before it. If they define no up, the angle is 0.
    """
    up = gravity.up_direction(poses)[0]
    if not up.any():
        return 0.0
    return float(np.degrees(np.arccos(np.clip(matrix[2, :3] @ up, -1, 1))))


def centring(corners: Vector, *, keep_height: bool = False) -> Matrix:
    """Return the shift that moves the footprint of a box, (8, 3) corners, to the origin.

    A box whose bottom is near z = 0 already stands on a floor there, so its height stays.

    Args:
        corners: of the box, in the world.
        keep_height: always keep the height of a floor at z = 0: the box may stand on a table.
    """
    low, high = corners.min(axis=0), corners.max(axis=0)
    matrix = np.eye(4)
    matrix[:2, 3] = -corners.mean(axis=0)[:2]
    if not keep_height and abs(low[2]) > ON_FLOOR * (high[2] - low[2]):
        matrix[2, 3] = -low[2]
    return matrix
