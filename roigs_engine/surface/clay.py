"""Draws a mesh as clay from four sides, for reports."""

from __future__ import annotations

import numpy as np
import torch

from ..model.scene import Camera, Float64
from ..photos.decode import Pixels
from ..rasterize.instances import NOTHING, surface_depth
from .mesh import Mask, Mesh

SIDE, FINER = 320, 2  # pixels of a picture, and samples of a pixel along a side
AWAY, LENS = 6.0, 5.8  # distance from the middle, and focal length in pictures, for a radius of 1
ABOVE = np.radians(20)
LIGHT = np.array([-0.5, -0.7, -0.6])  # towards it: from the left, above, behind the camera
CLAY, FILLED = np.array([0.86, 0.83, 0.79]), np.array([1.0, 0.55, 0.2])
AMBIENT = 0.35


def clay(mesh: Mesh, up: Float64) -> Pixels:
    """Draw a mesh on white, (SIDE, 4 SIDE, 3) uint8; parts that no photo has shown are orange.

    Args:
        up: (3, 3) rotation after which the mesh's y axis points up.
    """
    vertices = mesh.vertices @ up.T
    vertices -= (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    vertices /= max(float(np.linalg.norm(vertices, axis=1).max()), 1e-30)
    triangles = torch.from_numpy(vertices[mesh.faces].astype(np.float32))
    sides = [_picture(triangles, mesh.filled, np.radians(turned)) for turned in (30, 120, 210, 300)]
    return np.concatenate(sides, axis=1)


def _picture(triangles: torch.Tensor, filled: Mask, turned: float) -> Pixels:
    size = SIDE * FINER
    lens = LENS * size / 2
    camera = Camera(width=size, height=size, fx=lens, fy=lens, cx=size / 2, cy=size / 2)
    pose = _from(turned)
    depth = surface_depth(triangles, camera, pose).numpy()
    marked = surface_depth(triangles[torch.from_numpy(filled)], camera, pose).numpy()
    x = (np.arange(size) + 0.5 - size / 2) / lens
    there = depth < NOTHING
    points = np.stack([*np.meshgrid(x, x), np.ones_like(depth)], axis=-1)
    points *= np.where(there, depth, AWAY)[..., None]
    across, down = (_slope(points, axis) for axis in (1, 0))
    normals = np.cross(down, across)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)
    shade = AMBIENT + (1 - AMBIENT) * np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)
    colours = np.where((there & (marked <= depth))[..., None], FILLED, CLAY) * shade[..., None]
    colours[~there] = 1
    mean = colours.reshape(SIDE, FINER, SIDE, FINER, 3).mean(axis=(1, 3))
    return np.asarray((mean * 255).round(), dtype=np.uint8)


def _slope(points: Float64, axis: int) -> Float64:
    """Return vectors (H, W, 3) to the next pixel of an axis, by the neighbour nearer in depth."""
    before = points - np.roll(points, 1, axis)
    after = np.roll(points, -1, axis) - points
    nearer = np.abs(before[..., 2:]) < np.abs(after[..., 2:])
    return np.asarray(np.where(nearer, before, after))


def _from(turned: float) -> Float64:
    """Return world to camera (4, 4) of a camera that looks at the origin, `turned` around y."""
    level, rise = np.cos(ABOVE), np.sin(ABOVE)
    back = np.array([level * np.sin(turned), rise, level * np.cos(turned)])  # to the camera
    right = np.array([np.cos(turned), 0, -np.sin(turned)])
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(right, back), -back
    pose[2, 3] = AWAY
    return pose
