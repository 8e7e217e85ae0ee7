"""Irradiance on surfaces, from a panorama. Numpy only, no bpy.

A picture is equirectangular, as in Blender's Environment Texture: z is up, its middle column looks
along x, the column at a quarter of its width along y.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

ROWS = 32
"""Rows of the reduced picture: light from a cone of 6 degrees is treated as from its middle."""
AT_ONCE = 4096
"""Normals computed at once, so that they fit into memory with all directions."""


def flux(picture: Float32, rows: int = ROWS) -> Float32:
    """Reduce a picture (H, W, 3) to (h, w, 3): light times solid angle of larger pixels."""
    height, width = picture.shape[:2]
    step = max(1, height // rows)
    weighted = picture * directions(height, width)[1][..., None]
    high, wide = height // step, width // step
    cut = weighted[: high * step, : wide * step].reshape(high, step, wide, step, 3)
    return np.asarray(cut.sum(axis=(1, 3)), np.float32)


def directions(height: int, width: int) -> tuple[Float32, Float32]:
    """Return the direction of each pixel's centre (H, W, 3), and its solid angle (H, 1)."""
    up = np.pi * (0.5 - (np.arange(height) + 0.5) / height)
    turn = 2 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)
    flat, high = np.cos(up)[:, None], np.sin(up)[:, None]
    parts = flat * np.cos(turn), flat * np.sin(turn), np.broadcast_to(high, (height, width))
    size = flat * (np.pi / height) * (2 * np.pi / width)
    return np.stack(parts, axis=-1).astype(np.float32), size.astype(np.float32)


def on_normals(picture: Float32, normals: Float32) -> Float32:
    """(N, 3) colours of a white matt surface with each normal: irradiance divided by pi.

    Args:
        picture: (H, W, 3) linear light.
        normals: (N, 3) of length 1, in the picture's axes.
    """
    light = flux(picture)
    rays, weighted = directions(*light.shape[:2])[0].reshape(-1, 3), light.reshape(-1, 3) / np.pi
    parts = np.split(normals, range(AT_ONCE, len(normals), AT_ONCE))
    found: Float32 = np.concatenate([np.maximum(p @ rays.T, 0) @ weighted for p in parts])
    return found


def hemisphere(count: int) -> Float32:
    """Directions (count, 3) around z with cosine-weighted density, as for a matt surface."""
    k = np.arange(count) + 0.5
    radius, turn = np.sqrt(k / count), np.pi * (1 + np.sqrt(5)) * k
    parts = radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - k / count)
    found: Float32 = np.stack(parts, axis=-1).astype(np.float32)
    return found


def frames(normals: Float32) -> Float32:
    """Rotations (N, 3, 3) whose last column is each normal."""
    least = np.abs(normals).argmin(axis=1)
    across = np.cross(normals, np.eye(3, dtype=np.float32)[least])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    columns = [across, np.cross(normals, across), normals]
    found: Float32 = np.stack(columns, axis=-1).astype(np.float32)
    return found
