"""Converts between COLMAP's frame and Blender's; only this module does. No bpy.

All matrices are float64 numpy arrays (4, 4) that act on columns (docs/conventions.md, section
Blender).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

# OpenCV's camera axes (x right, y down, z forward) to Blender's (y up, z backward), and back.
FLIP: Matrix = np.diag([1.0, -1.0, -1.0, 1.0])

SENSOR_WIDTH = 36.0
"""Sensor width in mm, that of Blender's default camera; focal lengths are relative to it."""


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """A pinhole camera in pixels by COLMAP's convention: pixel centres at +0.5."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, kw_only=True)
class Lens:
    """The same camera in Blender's terms, with `sensor_fit = 'HORIZONTAL'`.

    Attributes:
        lens: focal length in millimetres on a sensor of SENSOR_WIDTH.
        shift_x, shift_y: in widths of the image.
        aspect_x, aspect_y: the scene's pixel aspect; the smaller one is 1, Blender's minimum.
    """

    lens: float
    shift_x: float
    shift_y: float
    aspect_x: float
    aspect_y: float


def lens_from_intrinsics(k: Intrinsics) -> Lens:
    """Return the camera `k` in Blender's terms."""
    ratio = k.fx / k.fy
    return Lens(
        lens=k.fx * SENSOR_WIDTH / k.width,
        shift_x=(k.width / 2 - k.cx) / k.width,
        shift_y=(k.cy - k.height / 2) * ratio / k.width,
        aspect_x=max(1.0, 1 / ratio),
        aspect_y=max(1.0, ratio),
    )


def intrinsics_from_lens(lens: Lens, width: int, height: int) -> Intrinsics:
    """Invert `lens_from_intrinsics`, at a resolution of width x height pixels."""
    fx = lens.lens * width / SENSOR_WIDTH
    ratio = lens.aspect_y / lens.aspect_x
    return Intrinsics(
        width=width,
        height=height,
        fx=fx,
        fy=fx / ratio,
        cx=width / 2 - lens.shift_x * width,
        cy=height / 2 + lens.shift_y * width / ratio,
    )


def clip_matrix(k: Intrinsics) -> Matrix:
    """(4, 4) from a camera's frame, OpenCV axes, to a clip space that ends at the picture's edges.

    A point is in the picture if |x| and |y| are at most w; w is its depth.
    """
    return np.array(
        [
            [2 * k.fx / k.width, 0, 2 * k.cx / k.width - 1, 0],
            [0, 2 * k.fy / k.height, 2 * k.cy / k.height - 1, 0],
            [0, 0, 1, 0],
            [0, 0, 1, 0],
        ]
    )


def camera_matrix(world_to_camera: Matrix) -> Matrix:
    """Return a Blender camera's matrix in the COLMAP frame (below the root) from its pose."""
    return np.linalg.inv(world_to_camera) @ FLIP


def world_to_camera(matrix: Matrix, root: Matrix) -> Matrix:
    """Return the pose in the COLMAP frame of a camera with the `matrix_world` `matrix`.

    Scale is removed: a scaled root also scales its cameras' axes, which does not change their
    pictures.
    """
    local = np.linalg.inv(root) @ matrix @ FLIP
    rotation, position = nearest_rotation(local[:3, :3]), local[:3, 3]
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -rotation.T @ position
    return pose


def nearest_rotation(matrix: Matrix) -> Matrix:
    """Return the rotation nearest to a matrix; a mirrored axis is flipped back."""
    u, _, v = np.linalg.svd(matrix)
    rotation: Matrix = u @ v
    if np.linalg.det(rotation) < 0:
        # A mirrored box is the same box: one axis reversed.
        rotation = matrix / np.linalg.norm(matrix, axis=0)
        rotation[:, 0] *= -1
        u, _, v = np.linalg.svd(rotation)
        rotation = u @ v
    return rotation
