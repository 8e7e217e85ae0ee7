"""Cameras of the tests; with numpy alone, which a real Blender has."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

Y_DOWN = (0.0, -1.0, 0.0)
"""What is up in a world whose y points down, as in COLMAP's models."""


def look_at(
    eye: ArrayLike, target: ArrayLike = (0.0, 0.0, 0.0), up: ArrayLike = (0.0, 0.0, 1.0)
) -> np.ndarray:
    """(4, 4) world_to_camera, OpenCV axes, of a camera at `eye` that looks at `target`."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye
    return pose


def rotation(random: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))
