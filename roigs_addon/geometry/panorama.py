"""Rays of Cycles' panoramic cameras. No bpy.

All functions take places in the picture, u (1, W) from its left edge and v (H, 1) from its lower
edge, both from 0 to 1. They return the places' directions, (H, W, 3) float32, in OpenCV's camera
axes (x right, y down, z forward). A direction is 0 where the picture is empty.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Rays = NDArray[np.float32]
Places = NDArray[np.float64]


def equirectangular(
    u: Places, v: Places, longitudes: tuple[float, float], latitudes: tuple[float, float]
) -> Rays:
    """Return the rays of an equirectangular panorama; ranges in radians, 0 is forward."""
    longitude = longitudes[0] + (longitudes[1] - longitudes[0]) * u
    latitude = latitudes[0] + (latitudes[1] - latitudes[0]) * v
    level = np.cos(latitude)
    return _rays(level * np.sin(longitude), -np.sin(latitude), level * np.cos(longitude))


def equidistant(u: Places, v: Places, angle: float) -> Rays:
    """Return the rays of a fisheye whose angles grow linearly to `angle` / 2 at the edges."""
    x, y = 2 * u - 1, 2 * v - 1
    radius = np.hypot(x, y)
    return _fisheye(x, y, radius, radius * angle / 2, radius <= 1)


def equisolid(u: Places, v: Places, angle: float, lens: float, sensor: tuple[float, float]) -> Rays:
    """Return the rays of an equal-area fisheye; its lens and the sensor's sides are in mm."""
    x, y = (u - 0.5) * sensor[0], (v - 0.5) * sensor[1]
    radius = np.hypot(x, y)
    away = 2 * np.arcsin(np.clip(radius / (2 * lens), 0, 1))
    return _fisheye(x, y, radius, away, radius <= 2 * lens * np.sin(angle / 4))


def _fisheye(x: Places, y: Places, radius: Any, away: Any, seen: Any) -> Rays:
    """Return rays at angles `away` from forward, towards x, y; 0 where (H, W) `seen` is false."""
    share = np.sin(away) / np.maximum(radius, 1e-12)
    rays = _rays(x * share, -y * share, np.cos(away))
    rays[~seen] = 0
    return rays


def _rays(x: Places, y: Places, z: Places) -> Rays:
    rays: Rays = np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(np.float32)
    return rays
