"""Maps places in the 3D view to pixels of the photo in a camera's frame, and back. No bpy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Frame = tuple[float, float, float, float]
"""Left, bottom, right and top in pixels of the region, from its lower left corner."""
Place = tuple[float, float]
Places = NDArray[np.float64]


def on_photo(
    place: tuple[float, float], frame: Frame, size: tuple[int, int]
) -> tuple[float, float]:
    """Convert a place in the region to pixels of the photo, from its upper left corner."""
    left, bottom, right, top = frame
    x = (place[0] - left) / max(right - left, 1e-6) * size[0]
    y = (top - place[1]) / max(top - bottom, 1e-6) * size[1]
    return x, y


def in_region(points: Sequence[Sequence[float]], frame: Frame, size: tuple[int, int]) -> Places:
    """Convert pixels of the photo, (N, 2), to places in the region, (N, 2)."""
    left, bottom, right, top = frame
    x, y = np.asarray(points, dtype=float).reshape(-1, 2).T
    across = left + x / size[0] * (right - left)
    return np.column_stack([across, top - y / size[1] * (top - bottom)])


def unit(frame: Frame, size: tuple[int, int]) -> float:
    """Return the number of photo pixels per pixel of the region."""
    return size[0] / max(frame[2] - frame[0], 1e-6)


def start(pressed: Place, before: Place | None, after: Place) -> Place:
    """Return the start of a stroke: `pressed`, or `before`, the last move before the press.

    If Blender is busy drawing, a press gets the mouse's place of a later time, but moves keep their
    own. So the place nearer to `after`, the first move after the press, is right.
    """
    if before is None:
        return pressed
    return min(pressed, before, key=lambda place: np.hypot(*np.subtract(place, after)))


def thinned(points: Sequence[tuple[float, float]], least: float) -> list[tuple[float, float]]:
    """Thin out a stroke to points at least `least` apart; its first and last points stay."""
    kept = list(points[:1])
    for point in points[1:]:
        if np.hypot(point[0] - kept[-1][0], point[1] - kept[-1][1]) >= least:
            kept.append(point)
    return kept if len(points) < 2 or kept[-1] == points[-1] else [*kept, points[-1]]
