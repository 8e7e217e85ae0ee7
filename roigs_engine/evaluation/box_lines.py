"""The edges of a box in the image."""

from __future__ import annotations

import numpy as np

from ..model.roi import EDGES, NEAR_SHARE, OrientedBox
from ..model.scene import Camera, Float64


def box_lines(
    roi: OrientedBox, camera: Camera, world_to_camera: Float64
) -> list[tuple[float, float, float, float]]:
    """The box's edges, x0, y0, x1, y1 in pixels, clipped to the image; hidden edges too."""
    corners = roi.corners() @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    near = NEAR_SHARE * roi.diagonal
    lines = []
    for a, b in EDGES:
        ends = _clipped_line(corners[a], corners[b], np.array([0.0, 0.0, 1.0]), -near)
        # The image's four sides as planes through the camera: n . p >= 0 is inside.
        for normal in (
            np.array([camera.fx, 0.0, camera.cx]),
            np.array([-camera.fx, 0.0, camera.width - camera.cx]),
            np.array([0.0, camera.fy, camera.cy]),
            np.array([0.0, -camera.fy, camera.height - camera.cy]),
        ):
            ends = None if ends is None else _clipped_line(*ends, normal, 0.0)
        if ends is not None:
            pixels = [
                (camera.fx * p[0] / p[2] + camera.cx, camera.fy * p[1] / p[2] + camera.cy)
                for p in ends
            ]
            lines.append((*pixels[0], *pixels[1]))
    return lines


def _clipped_line(
    a: Float64, b: Float64, normal: Float64, offset: float
) -> tuple[Float64, Float64] | None:
    """The part of the line from a to b where normal . p + offset >= 0, or None."""
    at_a, at_b = normal @ a + offset, normal @ b + offset
    if at_a < 0 and at_b < 0:
        return None
    if at_a >= 0 and at_b >= 0:
        return a, b
    middle = a + at_a / (at_a - at_b) * (b - a)
    return (a, middle) if at_a >= 0 else (middle, b)
