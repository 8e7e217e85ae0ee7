"""Carries masks to other photos by votes on sparse points and on colours.

For untrained scenes. Points are few. Between them, the nearest ones decide, together with the
colours that the object and its surroundings have so far.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from ..model.roi import OrientedBox
from ..model.scene import Float64, SfmScene, project
from .propagation import Knowledge, Prior, eroded
from .views import FREE, ON_OBJECT, Mask, View

Numbers = NDArray[np.float64]
NEAREST = 5  # nearest points that decide on a pixel
LEVELS, SMOOTHING = 16, 0.7  # levels of a channel's histogram; standard deviation of its smoothing
EDGE = 2.0  # pixels at a mask's outline that do not vote
TRUST, UNKNOWN = 0.5, 0.4  # see `Prior`; pixels between points are never certain
EVERY = 7  # every n-th pixel of strokes counts as a point


class PointVotes(Knowledge):
    """The sparse points of a box with each photo's votes, and the photos' colours."""

    def __init__(self, scene: SfmScene, roi: OrientedBox) -> None:
        """Args: `scene`, `roi`: in one frame."""
        inside = roi.contains(scene.points)
        rows = np.flatnonzero(inside)
        self._points = scene.points[rows]
        self._around = {
            image.name: scene.points[image.point_indices[~inside[image.point_indices]]]
            for image in scene.images
        }
        self._observed = {
            image.name: np.isin(rows, image.point_indices) if scene.has_tracks else None
            for image in scene.images
        }
        self._votes: dict[str, Numbers] = {}
        self._colours: dict[str, Numbers] = {}

    def learn_strokes(self, view: View) -> None:
        """Do nothing: `prior` uses strokes as points of their own photo."""

    def learn(self, view: View, mask: Mask, weight: float = 1.0) -> None:
        said = np.zeros(mask.shape)
        said[eroded(mask, EDGE)] = weight
        said[eroded(~mask, EDGE)] = -weight
        column, row, inside = self._places(view, self._points)
        seen = self._observed[view.name]
        counted = inside if seen is None else inside & seen
        votes = np.zeros(len(self._points))
        votes[counted] = said[row[counted], column[counted]]
        self._votes[view.name] = votes
        self._colours[view.name] = np.stack(
            [_histogram(view, eroded(mask, EDGE)), _histogram(view, eroded(~mask, EDGE))]
        )

    def prior(self, view: View, *, without: bool = True) -> Prior:
        others = [name for name in self._votes if not (without and name == view.name)]
        votes = sum((self._votes[name] for name in others), np.zeros(len(self._points)))
        places, labels = self._labelled(view, votes)
        in_box = view.near_box.astype(np.float32)
        found = 0.5 * in_box
        if len(places):
            found = _by_neighbours(places, labels, view) * in_box
        if others:
            histograms = np.sum([self._colours[name] for name in others], axis=0)
            found = (0.5 * found + 0.5 * _by_colour(view, histograms)) * in_box
        unknown = np.full(in_box.shape, UNKNOWN, np.float32)
        return Prior(
            in_object=found.astype(np.float32), in_box=in_box, unknown=unknown, trust=TRUST
        )

    def _labelled(self, view: View, votes: Numbers) -> tuple[Numbers, Numbers]:
        """(M, 2) labelled places in a photo, and (M,) 1 for the object, 0 for the rest.

        They are points of the box, other points that the photo observes, and its strokes.
        """
        column, row, inside = self._places(view, self._points)
        seen = self._observed[view.name]
        # Background points vote only if seen, because the object may hide them. The object's own
        # points are always in its silhouette.
        used = inside & ((votes > 0) | ((votes < 0) & (True if seen is None else seen)))
        across, down, there = self._places(view, self._around[view.name])
        stroke_rows, stroke_columns = (each[::EVERY] for each in np.nonzero(view.seeds != FREE))
        kinds = (
            (column[used], row[used], votes[used] > 0),
            (across[there], down[there], np.zeros(there.sum())),
            (stroke_columns, stroke_rows, view.seeds[stroke_rows, stroke_columns] == ON_OBJECT),
        )
        x, y, labels = (np.concatenate(each).astype(float) for each in zip(*kinds, strict=True))
        return np.column_stack([x, y]), labels

    @staticmethod
    def _places(view: View, points: Float64) -> tuple[NDArray[np.int64], NDArray[np.int64], Mask]:
        """Column and row of each point in a photo, and whether it is in view."""
        pixels, _, inside = project(points, view.camera, view.world_to_camera)
        column, row = np.where(inside[:, None], pixels, 0).astype(np.int64).T
        return column, row, inside


def _by_neighbours(places: Float64, labels: Float64, view: View) -> Numbers:
    """(H, W) share of the object among the nearest points; computed on a coarser grid."""
    from .views import opencv

    height, width = view.near_box.shape
    step = max(1, max(height, width) // 160)
    y, x = np.mgrid[0:height:step, 0:width:step]
    count = min(NEAREST, len(places))
    away, near = cKDTree(places).query(
        np.column_stack([x.ravel(), y.ravel()]), k=list(range(1, count + 1))
    )
    weights = 1 / (away + 1)
    share = (weights * labels[near]).sum(axis=1) / weights.sum(axis=1)
    grid = share.reshape(y.shape).astype(np.float32)
    grown: Numbers = opencv().resize(grid, (width, height))
    return grown


def _bins(view: View) -> tuple[NDArray[np.uint8], ...]:
    level: NDArray[np.uint8] = view.smooth // np.uint8(256 // LEVELS)
    return level[..., 0], level[..., 1], level[..., 2]


def _histogram(view: View, mask: Mask) -> Numbers:
    """(LEVELS, LEVELS, LEVELS) share of each colour in a photo's mask."""
    counts = np.zeros((LEVELS,) * 3)
    np.add.at(counts, tuple(channel[mask] for channel in _bins(view)), 1.0)
    found: Numbers = gaussian_filter(counts / max(1.0, counts.sum()), SMOOTHING, mode="nearest")
    return found


def _by_colour(view: View, histograms: Numbers) -> Numbers:
    """(H, W) the likelihood that a pixel shows the object, from its colour alone."""
    ratio = histograms[0] / np.maximum(histograms.sum(axis=0), 1e-12)
    ratio[histograms.sum(axis=0) < 1e-7] = 0.5
    found: Numbers = ratio[_bins(view)]
    return found
