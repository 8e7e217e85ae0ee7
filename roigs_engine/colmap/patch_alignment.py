"""Aligns photos' patches with reference patches: least-squares matching (Gruen 1985).

A patch is a photo's view of a square in the plane that touches a point. The place, shape and
contrast of a photo's patch are changed until it looks like the reference (Baker and Matthews 2004,
inverse compositional: the reference's gradients serve all iterations).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..kernels.bindings import kernels
from ..model.scene import Float64

HALF = 7  # a patch has 2 * HALF + 1 samples a side, spaced by a pixel of the coarser photo
_AXIS = np.arange(-HALF, HALF + 1, dtype=np.float32)
GRID: Grey = np.stack(np.meshgrid(_AXIS, _AXIS)).reshape(2, -1)
_WEIGHTS = np.exp(-(GRID**2).sum(axis=0) / (2 * (0.64 * HALF) ** 2))
WEIGHTS: Grey = (_WEIGHTS / _WEIGHTS.sum()).astype(np.float32)

LEAST_CONTRAST = 3.0  # least standard deviation of a patch, of 255; below, noise dominates
MOVES, BENDS = 4, 8  # iterations that change only the place, then the shape, too
PLAIN = 0.3  # damping of shape changes, in units of the normal equations
LONGEST_STEP, SETTLED = 1.0, 0.03  # samples: largest step; largest last step of a converged patch
MOST_BEND = 0.1  # largest change of a shape in an iteration
LIKENESS = 0.85  # least correlation
MOST_BENT = 1.5  # largest stretch or shrinking of the reference in one direction
VAGUEST = 0.35  # samples: places with a larger standard error are not used
INDEPENDENT = 20.0  # effective number of samples for the standard error; neighbours correlate
BATCH = 512  # patches at a time; many, so that threads seldom wait for the interpreter


def templates(
    photo: Pyramid, places: Float64, jacobians: Float64
) -> tuple[Grey, NDArray[np.bool_]]:
    """Sample a photo's patches around places (N, 2), px; jacobians (N, 2, 2): px per sample.

    Returns (N, P) with zero mean and unit variance, and (N,) whether they are complete and have
    contrast.
    """
    count = len(places)
    values = np.zeros((count, GRID.shape[1]), dtype=np.float32)
    usable = np.zeros(count, dtype=bool)
    for part in _parts(count):
        values[part], usable[part] = photo.patches(places[part], jacobians[part])
    return values, usable


def align(
    photo: Pyramid, places: Float64, jacobians: Float64, references: Grey, reach: Float64
) -> tuple[Float64, NDArray[np.bool_], Float64]:
    """Locate the references in a photo.

    Args:
        places: (N, 2) where the search starts, px.
        jacobians: (N, 2, 2) expected px of the photo per sample of a patch.
        references: (N, P) from `templates`.
        reach: (N,) largest distance of the result from its start, px.

    Returns:
        (N, 2) places, (N,) whether they can be trusted, (N,) correlations.
    """
    count = len(places)
    found, good, likeness = np.array(places), np.zeros(count, dtype=bool), np.zeros(count)
    for part in _parts(count):
        result = _aligned(photo, places[part], jacobians[part], references[part], reach[part])
        found[part], good[part], likeness[part] = result
    return found, good, likeness


def _parts(count: int) -> list[slice]:
    return [slice(k, k + BATCH) for k in range(0, count, BATCH)]


def _aligned(
    photo: Pyramid, places: Float64, jacobians: Float64, references: Grey, reach: Float64
) -> tuple[Float64, NDArray[np.bool_], Float64]:
    count = len(places)
    slopes = _slopes(references)  # (N, P, 6): changes by moves and shapes
    weighted = slopes * WEIGHTS[None, :, None]
    normal = (weighted.transpose(0, 2, 1) @ slopes).astype(np.float64)
    normal[:, range(6), range(6)] += np.array([1e-6] * 2 + [PLAIN] * 4)
    inverses = {2: np.linalg.inv(normal[:, :2, :2]), 6: np.linalg.inv(normal)}
    shape, move = np.tile(np.eye(2), (count, 1, 1)), np.zeros((count, 2))
    step = np.zeros((count, 2))

    def sampled() -> tuple[Grey, NDArray[np.bool_]]:
        at = places + (jacobians @ move[:, :, None])[..., 0]
        return photo.patches(at, jacobians @ shape)

    for turn in range(MOVES + BENDS):
        error = sampled()[0] - references
        right = (error[:, None, :] @ weighted)[:, 0].astype(np.float64)
        free = 2 if turn < MOVES else 6
        solved = (inverses[free] @ right[:, :free, None])[..., 0]
        step = np.clip(solved[:, :2], -LONGEST_STEP, LONGEST_STEP)
        bend = np.tile(np.eye(2), (count, 1, 1))
        if free == 6:
            bend += np.clip(solved[:, 2:].reshape(count, 2, 2), -MOST_BEND, MOST_BEND)
        shape = shape @ _inverse(bend)
        move = np.clip(move - (shape @ step[:, :, None])[..., 0], -2 * HALF, 2 * HALF)
    patch, usable = sampled()
    left = patch - references
    variance = (left * left) @ WEIGHTS / INDEPENDENT
    variances = inverses[6][:, :2, :2].trace(axis1=1, axis2=2) * variance
    likeness = (patch * references) @ WEIGHTS
    offset = (jacobians @ move[:, :, None])[..., 0]
    stretch = np.linalg.svd(shape, compute_uv=False)
    good = usable & (likeness > LIKENESS) & (np.linalg.norm(offset, axis=1) < reach)
    good &= (stretch[:, 0] < MOST_BENT) & (stretch[:, 1] > 1 / MOST_BENT)
    good &= (np.linalg.norm(step, axis=1) < SETTLED) & (np.sqrt(variances) < VAGUEST)
    return places + offset, good, likeness.astype(np.float64)


def _inverse(matrices: Float64) -> Float64:
    """The inverses of (N, 2, 2); numpy's function takes 30 times as long."""
    (a, b), (c, d) = matrices.transpose(1, 2, 0)
    adjugate = np.array([[d, -b], [-c, a]]) / (a * d - b * c)
    return np.asarray(adjugate.transpose(2, 0, 1))


def _slopes(references: Grey) -> Grey:
    """(N, P, 6): how patches change with x, y, and the four numbers of the shape."""
    side = 2 * HALF + 1
    square = references.reshape(-1, side, side)
    down, right = (slope.reshape(len(references), -1) for slope in np.gradient(square, axis=(1, 2)))
    x, y = GRID
    slopes = np.stack([right, down, right * x, right * y, down * x, down * y], axis=2)
    mean = (slopes * WEIGHTS[None, :, None]).sum(axis=1, keepdims=True)
    return np.asarray(slopes - mean)


Grey = NDArray[np.float32]

LEVELS = 5
FIRST_BLUR, BLUR = 0.6, 1.0  # px: first, against the sensor's patterns; then before each halving
LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)


class Pyramid:
    """The photo at 1, 1/2, 1/4 ... of its size."""

    def __init__(self, path: Path, size: tuple[int, int], turn: int = 1) -> None:
        """Read a photo at (width, height), turned (see `PosedImage`); raises PhotoError."""
        from scipy.ndimage import gaussian_filter

        from ..photos.decode import decode

        grey: Grey = decode(path, size, turn).astype(np.float32) @ LUMA
        self._levels: list[Grey] = [gaussian_filter(grey, FIRST_BLUR)]
        while len(self._levels) < LEVELS and min(self._levels[-1].shape) >= 8:
            halved = gaussian_filter(self._levels[-1], BLUR)[::2, ::2]
            self._levels.append(np.ascontiguousarray(halved))

    def patches(self, places: Float64, jacobians: Float64) -> tuple[Grey, NDArray[np.bool_]]:
        """Sample patches around places (N, 2), px; jacobians (N, 2, 2): px per sample.

        Returns (N, P) with zero mean and unit variance, linearly interpolated in the level whose
        pixel size is nearest to the samples' distance; and (N,) whether they are complete and have
        contrast.
        """
        scale = np.sqrt(np.abs(np.linalg.det(jacobians)))
        level = np.rint(np.log2(np.maximum(np.nan_to_num(scale), 1e-6))).astype(np.int64)
        level = np.clip(level, 0, len(self._levels) - 1)
        values = np.empty((len(places), GRID.shape[1]), dtype=np.float32)
        usable = np.empty(len(places), dtype=bool)
        for k in np.unique(level):
            rows = np.flatnonzero(level == k)
            # Level k has every 2^k-th pixel of the photo. Centres of pixels are at + 0.5.
            centres = (places[rows] - 0.5) * 0.5**k
            values[rows], usable[rows] = _patches(
                self._levels[k], centres.astype(np.float32), jacobians[rows] * 0.5**k
            )
        return values, usable


def _patches(grey: Grey, centres: Grey, shapes: Float64) -> tuple[Grey, NDArray[np.bool_]]:
    height, width = grey.shape
    count = len(centres)
    patches = np.empty((count, GRID.shape[1]), dtype=np.float32)
    if min(width, height) < 2:  # too small to interpolate, so no patch is complete
        return np.zeros_like(patches), np.zeros(count, dtype=bool)
    deviations, inside = np.empty(count, dtype=np.float32), np.empty(count, dtype=bool)
    shapes = np.ascontiguousarray(shapes, dtype=np.float32)
    given = (grey.ctypes.data, width, height, centres.ctypes.data, shapes.ctypes.data, count)
    results = (values.ctypes.data for values in (patches, deviations, inside))
    kernels().roigs_patches(*given, HALF, WEIGHTS.ctypes.data, *results)
    return patches, inside & (deviations > LEAST_CONTRAST)
