"""A grey photo in halved sizes, sampled anywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.float32]

LEVELS = 5
FIRST_BLUR, BLUR = 0.6, 1.0  # px: against the grid's and the sensor's patterns; before each halving
LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)


class Pyramid:
    """The photo at 1, 1/2, 1/4 ... of its size."""

    def __init__(self, path: Path, size: tuple[int, int]) -> None:
        """Read a photo at (width, height); raises PhotoError."""
        from scipy.ndimage import gaussian_filter

        from ...photos.decode import decode

        grey: Grey = decode(path, size).astype(np.float32) @ LUMA
        self._levels: list[Grey] = [gaussian_filter(grey, FIRST_BLUR)]
        while len(self._levels) < LEVELS and min(self._levels[-1].shape) >= 8:
            halved = gaussian_filter(self._levels[-1], BLUR)[::2, ::2]
            self._levels.append(np.ascontiguousarray(halved))

    def sample(self, places: Grey, scale: Grey) -> tuple[Grey, NDArray[np.bool_]]:
        """(N, P) grey values, linearly interpolated; and (N,) whether all places are in the photo.

        Args:
            places: (2, N, P) x and y, px of the photo.
            scale: (N,) distance between a row's places, px: decides the level.
        """
        level = np.rint(np.log2(np.maximum(scale, 1e-6)))
        level = np.clip(np.nan_to_num(level), 0, len(self._levels) - 1).astype(np.int64)
        values = np.empty(places.shape[1:], dtype=np.float32)
        inside = np.empty(len(level), dtype=bool)
        for k in np.unique(level):
            rows = level == k
            # Level k has every 2^k-th pixel of the photo, and these have their centres at + 0.5.
            at = (places[:, rows] - np.float32(0.5)) * np.float32(0.5**k)
            values[rows], inside[rows] = _interpolated(self._levels[k], at[0], at[1])
        return values, inside


def _interpolated(grey: Grey, x: Grey, y: Grey) -> tuple[Grey, NDArray[np.bool_]]:
    height, width = grey.shape
    inside = ((x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)).all(axis=1)
    x = np.clip(np.nan_to_num(x), 0, width - 1.001)
    y = np.clip(np.nan_to_num(y), 0, height - 1.001)
    left, top = x.astype(np.int32), y.astype(np.int32)
    right, down = x - left, y - top
    flat, first = grey.ravel(), top * width + left
    above = flat[first] + (flat[first + 1] - flat[first]) * right
    below = flat[first + width]
    below = below + (flat[first + width + 1] - below) * right
    return above + (below - above) * down, inside
