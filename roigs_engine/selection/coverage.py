"""`coverage`: show each point from many directions and at high resolution (ours).

Facility location over points x viewing-direction bins, for the photos S:

    F(S) = sum_p w_p sum_b max_{v in S, bin(v, p) = b} vis(v, p) min(1, rho(v, p) / rho*)

rho = f / z * cos(theta) is the number of pixels of photo v per world unit of the surface at p. rho*
is its 90th percentile over all observations. b is one of the bins of directions from p to the
camera. The weights w_p give each voxel (see score.py) the same total weight; a point that masks of
the object show to be something else has none. F is monotone and
submodular: lazy greedy equals greedy, it reaches at least 1 - 1/e of the best set of its size, and
each prefix is the greedy result for that number of photos.

theta is the angle between the ray and the surface normal. SfM points have no normals. A normal is
estimated from the neighbouring points if these lie on a surface; otherwise cos(theta) = 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..model.mask_coverage import object_points
from ..model.scene import Float64, Int64
from ..model.visibility import Candidates
from .baselines import fill_up
from .greedy import lazy_greedy
from .neighbours import nearest_neighbours
from .records import Picks
from .score import voxel_indices

RESOLUTION_PERCENTILE = 90.0
DIRECTIONS = 32  # bins of viewing directions
# Number of points, the point included, that a normal is fitted to.
NORMAL_NEIGHBOURS = 16
# Neighbours lie on a surface if the spread across it is below this share of the smaller spread
# along it (standard deviations); points along a line do not.
FLATNESS = 0.5
# Lower limit of cos(theta): the photo does observe the point, so a lower value is an estimation
# error.
MIN_COSINE = 0.2
ROWS = 1 << 16  # observations that are compared with all directions at once


class Coverage:
    """F(S) of a growing set S of photos, as a share of F(all candidates)."""

    def __init__(self, candidates: Candidates, context: Context = QUIET) -> None:
        self._starts = candidates.row_starts()
        view, point = candidates.obs_view, candidates.obs_point
        ray = candidates.centres()[view] - candidates.points[point]  # (N, 3) point to camera
        length = np.linalg.norm(ray, axis=1)
        ray /= np.maximum(length, np.finfo(float).tiny)[:, None]
        density = _pixel_density(candidates) * _cosines(candidates, ray, context)
        best = np.percentile(density, RESOLUTION_PERCENTILE) if len(density) else 0.0
        share = np.minimum(1.0, density / best) if best > 0 else np.zeros(len(density))
        voxel = voxel_indices(candidates.points, candidates.roi)
        weight = 1.0 / np.bincount(voxel)[voxel]
        shown = object_points(candidates.points, candidates.roi, candidates.images)
        if shown.any():
            weight[~shown] = 0.0
        directions = fibonacci_directions(DIRECTIONS)
        slot = point * DIRECTIONS + nearest_direction(ray, directions)
        slots, self._slot = np.unique(slot, return_inverse=True)
        self._worth = weight[point] * share  # (N,)
        self._held = np.zeros(len(slots))
        full = np.zeros(len(slots))
        np.maximum.at(full, self._slot, self._worth)
        self._full = float(full.sum())

    @property
    def value(self) -> float:
        """F(S) / F(all candidates), 0 to 1."""
        return float(self._held.sum()) / self._full if self._full > 0 else 0.0

    def gain(self, view: int) -> float:
        """F(S + v) - F(S), in the unit of `value`; never increases as S grows."""
        part = slice(self._starts[view], self._starts[view + 1])
        added = np.maximum(self._worth[part] - self._held[self._slot[part]], 0.0)
        return float(added.sum()) / self._full if self._full > 0 else 0.0

    def add(self, view: int) -> None:
        """Add a photo to S."""
        part = slice(self._starts[view], self._starts[view + 1])
        np.maximum.at(self._held, self._slot[part], self._worth[part])


def order_coverage(candidates: Candidates, count: int, context: Context = QUIET) -> Picks:
    """Greedy order: each photo increases F most; then farthest views."""
    coverage = Coverage(candidates, context)
    order = lazy_greedy(list(range(len(candidates))), coverage.gain, coverage.add, count, context)
    return fill_up(candidates, order, count)


def prefix_coverage(
    candidates: Candidates, order: tuple[int, ...], context: Context = QUIET
) -> tuple[float, ...]:
    """F / F(all candidates) after each pick of `order`."""
    coverage = Coverage(candidates, context)
    values = []
    for view in order:
        coverage.add(view)
        values.append(coverage.value)
    return tuple(values)


def fibonacci_directions(count: int) -> Float64:
    """(count, 3) unit vectors spread evenly over the sphere (Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    height = 1 - 2 * index / count
    angle = np.pi * (1 + np.sqrt(5)) * index
    radius = np.sqrt(1 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def nearest_direction(rays: Float64, directions: Float64) -> Int64:
    """(N, 3) unit rays, (B, 3) unit directions -> (N,) index of each ray's nearest direction."""
    parts = [rays[start : start + ROWS] for start in range(0, len(rays), ROWS)]
    return np.concatenate([np.argmax(part @ directions.T, axis=1) for part in parts])


def _pixel_density(candidates: Candidates) -> Float64:
    """(N,) f / z of each observation, pixels per world unit; 0 where z is not positive."""
    starts = candidates.row_starts()
    density = np.zeros(len(candidates.obs_view))
    near = 1e-6 * candidates.roi.diagonal
    for index, image in enumerate(candidates.images):
        part = slice(starts[index], starts[index + 1])
        points = candidates.points[candidates.obs_point[part]]
        depth = points @ image.world_to_camera[2, :3] + image.world_to_camera[2, 3]
        focal = np.sqrt(image.camera.fx * image.camera.fy)
        density[part] = np.where(depth > near, focal / np.maximum(depth, near), 0.0)
    return density


def _cosines(candidates: Candidates, rays: Float64, context: Context) -> Float64:
    """(N,) cos(theta) of each observation, at least `MIN_COSINE`; 1 if the normal is unknown."""
    normals, known = _normals(candidates, rays, context)
    point = candidates.obs_point
    cosine = np.einsum("ni,ni->n", rays, normals[point])
    return np.where(known[point], np.clip(cosine, MIN_COSINE, 1.0), 1.0)


def _normals(
    candidates: Candidates, rays: Float64, context: Context
) -> tuple[Float64, NDArray[np.bool_]]:
    """(P, 3) unit normals by PCA, towards the observers; (P,) whether each is known."""
    points = candidates.points
    total = len(points)
    if total < NORMAL_NEIGHBOURS:
        return np.zeros((total, 3)), np.zeros(total, dtype=bool)
    neighbours = points[nearest_neighbours(points, NORMAL_NEIGHBOURS, context)]  # (P, k, 3)
    centred = neighbours - neighbours.mean(axis=1, keepdims=True)
    covariance = np.einsum("pki,pkj->pij", centred, centred) / NORMAL_NEIGHBOURS
    values, vectors = np.linalg.eigh(covariance)  # ascending
    normals = vectors[:, :, 0]
    spread = np.sqrt(np.maximum(values, 0.0))
    known = (spread[:, 1] > 0) & (spread[:, 0] < FLATNESS * spread[:, 1])
    observers = np.zeros((total, 3))
    np.add.at(observers, candidates.obs_point, rays)
    away = np.einsum("pi,pi->p", normals, observers) < 0
    return np.where(away[:, None], -normals, normals), known
