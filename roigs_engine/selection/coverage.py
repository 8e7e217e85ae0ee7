"""`coverage`: selects photos that show each point from many directions, at high resolution (ours).

Facility location over points x viewing-direction bins, for the photos S:

    F(S) = sum_p w_p sum_b max_{v in S, bin(v, p) = b} vis(v, p) min(1, rho(v, p) / rho*)

rho = f / z * cos(theta) is the number of pixels of photo v per world unit of the surface at p. rho*
is its 90th percentile over all observations. b is one of the bins of directions from p to the
camera. The weights w_p give each voxel (see score.py) the same total weight; points outside the
object's masks have weight 0. F is monotone and submodular. So lazy greedy equals greedy, it reaches
at least 1 - 1/e of the best set of its size, and each prefix is the greedy result for that number
of photos.

theta is the angle between the ray and the surface normal. SfM points have no normals. A normal is
estimated from the neighbouring points if these lie on a surface; otherwise cos(theta) = 1.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..model.leaves import LEAF, leaves_of
from ..model.mask_coverage import object_points
from ..model.scene import Float64, Int64
from ..model.visibility import Candidates
from .baselines import fill_up
from .greedy import lazy_greedy
from .request import Picks, Request
from .score import voxel_indices

RESOLUTION_PERCENTILE = 90.0
DIRECTIONS = 32  # bins of viewing directions
NORMAL_NEIGHBOURS = 16  # points for fitting a normal, the point itself included
# Neighbours lie on a surface if they deviate across it by less than this share of the smaller
# deviation along it (standard deviations); points along a line do not.
FLATNESS = 0.5
# Lower limit of cos(theta): the photo does observe the point, so a lower value is an estimation
# error.
MIN_COSINE = 0.2
ROWS = 1 << 16  # observations to compare with all directions at once
PART = 1 << 21  # observations with rays in memory at once


class Coverage:
    """F(S) for a growing set S of photos, as a share of F(all candidates)."""

    def __init__(self, candidates: Candidates, context: Context = QUIET) -> None:
        self._starts = candidates.row_starts()
        point = candidates.obs_point
        normals, known = surface_normals(candidates, context)
        directions = fibonacci_directions(DIRECTIONS)
        density = _pixel_density(candidates)
        slot = np.empty(len(point), dtype=np.int64)
        for part, rays in _rays(candidates):
            context.check_cancelled()
            of = point[part]
            cosine = np.einsum("ni,ni->n", rays, normals[of])
            density[part] *= np.where(known[of], np.clip(cosine, MIN_COSINE, 1.0), 1.0)
            slot[part] = of * DIRECTIONS + nearest_direction(rays, directions)
        best = np.percentile(density, RESOLUTION_PERCENTILE) if len(density) else 0.0
        share = np.minimum(1.0, density / best) if best > 0 else np.zeros(len(density))
        voxel = voxel_indices(candidates.points, candidates.roi)
        weight = 1.0 / np.bincount(voxel)[voxel]
        shown = object_points(candidates.points, candidates.roi, candidates.images)
        if shown.any():
            weight[~shown] = 0.0
        used = np.bincount(slot, minlength=len(weight) * DIRECTIONS) > 0
        self._slot = (np.cumsum(used) - 1)[slot]  # (N,) index among the used slots
        self._worth = weight[point] * share  # (N,)
        self._held = np.zeros(int(used.sum()))
        np.maximum.at(self._held, self._slot, self._worth)
        self._full = float(self._held.sum())
        self.clear()

    def clear(self) -> None:
        """Make S empty."""
        self._held[:] = 0.0

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


def order_coverage(request: Request) -> Picks:
    """Order photos greedily: each increases F most; farthest views follow."""
    views, context = list(range(len(request.candidates))), request.context
    coverage = Coverage(request.candidates, context)
    order = lazy_greedy(views, coverage.gain, coverage.add, request.count, context)
    return fill_up(request, order, coverage)


def fibonacci_directions(count: int) -> Float64:
    """(count, 3) unit vectors, evenly over the sphere (Fibonacci lattice)."""
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


def _rays(candidates: Candidates) -> Iterator[tuple[slice, Float64]]:
    """Yield parts of the observations, with their unit vectors (N, 3) from point to camera."""
    centres = candidates.centres()
    for start in range(0, len(candidates.obs_view), PART):
        part = slice(start, start + PART)
        rays = centres[candidates.obs_view[part]] - candidates.points[candidates.obs_point[part]]
        rays /= np.maximum(np.linalg.norm(rays, axis=1), np.finfo(float).tiny)[:, None]
        yield part, rays


def surface_normals(candidates: Candidates, context: Context) -> tuple[Float64, NDArray[np.bool_]]:
    """Estimate unit normals (P, 3) by PCA, towards the observers; (P,) whether each is known."""
    points = candidates.points
    total = len(points)
    if total < NORMAL_NEIGHBOURS:
        return np.zeros((total, 3)), np.zeros(total, dtype=bool)
    neighbours = points[nearest_neighbours(points, NORMAL_NEIGHBOURS, context)]  # (P, k, 3)
    centred = neighbours - neighbours.mean(axis=1, keepdims=True)
    covariance = np.einsum("pki,pkj->pij", centred, centred) / NORMAL_NEIGHBOURS
    values, vectors = np.linalg.eigh(covariance)  # ascending
    normals = vectors[:, :, 0]
    deviation = np.sqrt(np.maximum(values, 0.0))
    known = (deviation[:, 1] > 0) & (deviation[:, 0] < FLATNESS * deviation[:, 1])
    observers = np.zeros((total, 3))
    for part, rays in _rays(candidates):
        np.add.at(observers, candidates.obs_point[part], rays)
    away = np.einsum("pi,pi->p", normals, observers) < 0
    return np.where(away[:, None], -normals, normals), known


MANY = 100  # leaves to search; with more, the group is divided


def nearest_neighbours(points: Float64, count: int, context: Context = QUIET) -> Int64:
    """(P, 3) points -> (P, count) rows of the nearest points, the point included, unordered.

    `count` is at most P and `LEAF` / 2.
    """
    assert count <= min(len(points), LEAF // 2)
    leaves = leaves_of(points)
    low = np.array([points[leaf].min(axis=0) for leaf in leaves])
    high = np.array([points[leaf].max(axis=0) for leaf in leaves])
    found = np.empty((len(points), count), dtype=np.int64)
    for leaf in leaves:
        context.check_cancelled()
        centre = points[leaf].mean(axis=0)  # near zero, distances are exact
        own = points[leaf] - centre
        farthest = np.partition(_squared(own, own), count - 1, axis=1)[:, count - 1]
        bounds = np.maximum(farthest, 0.0)
        groups = [np.argsort(bounds)]
        while groups:
            group = groups.pop()
            rows = points[leaf[group]]
            gap = np.maximum(np.maximum(low - rows.max(axis=0), rows.min(axis=0) - high), 0.0)
            # Rounding must not lose a neighbour exactly at the bound.
            near = np.flatnonzero((gap**2).sum(axis=1) <= bounds[group[-1]] * (1 + 1e-9))
            if len(near) > MANY and len(group) > 1:
                groups += [group[: len(group) // 2], group[len(group) // 2 :]]
                continue
            others = np.concatenate([leaves[other] for other in near])
            distance = _squared(own[group], points[others] - centre)
            if len(others) > count:
                others = others[np.argpartition(distance, count - 1, axis=1)[:, :count]]
            found[leaf[group]] = others
    return found


def _squared(a: Float64, b: Float64) -> Float64:
    """(A, 3), (B, 3) -> (A, B) squared distances."""
    return np.asarray((a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T)
