"""Surface patches of a boxed object: from sparse points, and from their hull where there are none.

A side without photos has no points. Patches of the points' convex hull represent it, except where
photos have seen that the place is empty. So missing sides are on the map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..model.mask_coverage import object_points
from ..model.scene import Float64, Int64
from ..model.visibility import Candidates
from ..selection.coverage import nearest_neighbours, surface_normals
from .space import Space

ALONG_LONGEST_SIDE = 24  # patches along the longest side of the box
FEWEST = 8  # points needed for a hull
ALONE = 4.0  # x the median distance between neighbours; points farther from theirs are strays


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    """P patches of about equal size.

    Attributes:
        places: (P, 3) world positions.
        normals: (P, 3) unit vectors out of the surface.
        points: (P,) their rows of `Candidates.points`; -1: a patch of the hull.
        side: approximate side of a patch, world units.
    """

    places: Float64
    normals: Float64
    points: Int64
    side: float

    def __len__(self) -> int:
        return len(self.places)

    @property
    def guessed(self) -> NDArray[np.bool_]:
        """(P,) whether each patch is from the hull, where no photo shows a point."""
        return np.asarray(self.points < 0)


def surface_patches(candidates: Candidates, space: Space, context: Context = QUIET) -> Patches:
    """Make the patches of a box from the points that its photos observe."""
    side = float(2 * candidates.roi.half_extents.max()) / ALONG_LONGEST_SIDE
    shown = object_points(candidates.points, candidates.roi, candidates.images)
    observed = np.bincount(candidates.obs_point, minlength=len(candidates.points)) > 0
    use = shown & observed
    if not use.any():
        use = observed
    normals = _normals(candidates, context)
    rows = _one_in_each_cell(candidates.points, use, side)
    places, ways = _hull(candidates.points[use], space, side, context)
    return Patches(
        places=np.concatenate([candidates.points[rows], places]),
        normals=np.concatenate([normals[rows], ways]),
        points=np.concatenate([rows, np.full(len(places), -1)]).astype(np.int64),
        side=side,
    )


def _normals(candidates: Candidates, context: Context) -> Float64:
    """(P, 3) unit normals; if a point's neighbours are no surface, its mean observer direction."""
    normals, known = surface_normals(candidates, context)
    centres = candidates.centres()
    ways = centres[candidates.obs_view] - candidates.points[candidates.obs_point]
    ways /= np.maximum(np.linalg.norm(ways, axis=1), 1e-300)[:, None]
    mean = np.zeros((len(candidates.points), 3))
    np.add.at(mean, candidates.obs_point, ways)
    found = np.where(known[:, None], normals, mean)
    return np.asarray(found / np.maximum(np.linalg.norm(found, axis=1), 1e-300)[:, None])


def _one_in_each_cell(points: Float64, use: NDArray[np.bool_], side: float) -> Int64:
    """Rows of the used points (P, 3): in each cell of a grid, the one nearest to its middle."""
    rows = np.flatnonzero(use)
    cells = points[rows] / side
    index = np.floor(cells)
    away = np.linalg.norm(cells - index - 0.5, axis=1)
    order = np.lexsort((away, *index.T))
    _, first = np.unique(index[order], axis=0, return_index=True)
    return np.sort(rows[order[first]]).astype(np.int64)


def _hull(points: Float64, space: Space, side: float, context: Context) -> tuple[Float64, Float64]:
    """Places (N, 3) on the points' convex hull that are far from all points, and the normals."""
    from scipy.spatial import ConvexHull, QhullError, cKDTree

    nothing = np.zeros((0, 3)), np.zeros((0, 3))
    if len(points) < FEWEST:
        return nothing
    near = nearest_neighbours(points, FEWEST, context)
    spread = np.linalg.norm(points[near] - points[:, None], axis=2).max(axis=1)
    points = points[spread <= ALONE * max(float(np.median(spread)), side / 2)]
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # all points in one plane, or too few
        return nothing
    corners = points[hull.simplices]  # (F, 3, 3)
    areas = (
        np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        / 2
    )
    counts = np.ceil(areas / side**2).astype(int)
    face = np.repeat(np.arange(len(counts)), counts)
    # A single sequence fills all faces evenly (Roberts 2018).
    share = (0.5 + np.arange(len(face))[:, None] * (0.7548776662466927, 0.5698402909980532)) % 1
    share = np.where(share.sum(axis=1, keepdims=True) > 1, 1 - share, share)
    a, b, c = corners[face, 0], corners[face, 1], corners[face, 2]
    places = a + share[:, :1] * (b - a) + share[:, 1:] * (c - a)
    ways = hull.equations[face, :3]
    away, _ = cKDTree(points).query(places)
    kept = np.flatnonzero((away > 1.5 * side) & ~space.passed(places - ways * space.cell / 2))
    thinned = kept[_one_in_each_cell(places[kept], np.ones(len(kept), bool), side)]
    return places[thinned], ways[thinned]
