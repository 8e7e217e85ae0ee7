"""Locates a model's points in photos, to a few hundredths of a pixel (track matching).

Each point has one reference photo. Its patch is searched for in the other photos, even if the
detector found no keypoint there (docs/method.md, "Cameras").
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..context import Context
from ..model.scene import Float64, Int64
from ..photos.headers import PhotoError, photo_size
from ..photos.parallel import decoding_bytes, in_parallel
from .patch_alignment import GRID, Pyramid, align, templates

NEW_A_PHOTO = 1000  # most points searched in a photo that does not observe them yet
MOST_WRONG = 3.0  # px: observations farther from their projected point are wrong matches
REACH, NEW_REACH = 3.0, 1.5  # px: search radius around a keypoint; around a projected point
NEW_LIKENESS = 0.9
WIDEST, NARROW = 0.72, 0.9  # cosines of angles between photos: the widest; narrower has no effect
COARSEST, FINEST = 8.0, 0.5  # size of a photo's pixels at the point, relative to the reference's
RIM = 8.0  # px: closer to the photo's edge, patches are incomplete
PYRAMID = 24  # bytes for each pixel of a photo, most of them while its levels are computed


@dataclass(frozen=True, kw_only=True, eq=False)
class Matches:
    """M observations of P points.

    Attributes:
        points: (P, 3) approximate positions, world units.
        view, point: (M,) rows of `Views` and of `points`.
        places: (M, 2) px of the photos.
        reference: (M,) whether it is the reference for the others of its point.
    """

    points: Float64
    view: Int64
    point: Int64
    places: Float64
    reference: NDArray[np.bool_]


class _Wanted(NamedTuple):
    """M places to match."""

    view: Int64  # see `Matches`
    point: Int64
    start: Float64  # (M, 2) start of the search, px
    new: NDArray[np.bool_]  # (M,) the photo has no keypoint of the point yet


class _References(NamedTuple):
    """The reference observation of each point; -1: it has none."""

    row: Int64  # (P,) of the observations
    view: Int64  # (P,) its photo
    place: Float64  # (P, 2) its keypoint, px
    normal: Float64  # (P, 3) unit vectors towards the photos


class PhotoFile(NamedTuple):
    """A photo on disk, and the turn of its pixels (see `PosedImage`)."""

    path: Path
    turn: int


def match_tracks(scene: Any, photos: Sequence[PhotoFile | None], context: Context) -> Matches:
    """Match the tracks of a pycolmap reconstruction.

    Args:
        scene: its points, tracks and cameras must be right to about a pixel.
        photos: the file of each of `Views(scene).ids`; None: missing.
    """
    views = Views(scene)
    usable = np.array([file is not None for file in photos])
    seen = _observations(scene, views, usable)
    references = _references(views, seen)
    wanted = _wanted(views, seen, references, usable, np.random.default_rng(0))
    # The matrices are small, so threads would only wait for each other.
    with threadpool_limits(limits=1, user_api="blas"):
        places, good = _matched(views, photos, seen.points, references, wanted, context)
    found = np.flatnonzero(good)
    points = np.unique(wanted.point[found])
    return Matches(
        points=seen.points,
        view=np.concatenate([references.view[points], wanted.view[found]]),
        point=np.concatenate([points, wanted.point[found]]),
        places=np.concatenate([references.place[points], places[found]]),
        reference=np.arange(len(points) + len(found)) < len(points),
    )


def _observations(scene: Any, views: Views, usable: NDArray[np.bool_]) -> Matches:
    """The observations in the tracks, without wrong matches; `reference` is False."""
    keys = sorted(scene.point3D_ids())
    point_of = {key: row for row, key in enumerate(keys)}
    positions = np.array([scene.points3D[key].xyz for key in keys]).reshape(-1, 3)
    view, point, place = [], [], []
    for row, key in enumerate(views.ids):
        if not usable[row]:
            continue
        image = scene.images[key]
        observed = [k for k, keypoint in enumerate(image.points2D) if keypoint.has_point3D()]
        rows = np.array([point_of[image.points2D[k].point3D_id] for k in observed], dtype=int)
        places = np.array([image.points2D[k].xy for k in observed]).reshape(-1, 2)
        error = np.linalg.norm(views.project(row, positions[rows]) - places, axis=1)
        right = error < MOST_WRONG
        view.append(np.full(int(right.sum()), row))
        point.append(rows[right])
        place.append(places[right])
    if not view:
        view, point, place = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros((0, 2))]
    rows = np.concatenate(point)
    return Matches(
        points=positions,
        view=np.concatenate(view),
        point=rows,
        places=np.concatenate(place),
        reference=np.zeros(len(rows), dtype=bool),
    )


def _references(views: Views, seen: Matches) -> _References:
    """Choose for each point the photo to which most of its others can be matched."""
    count = len(seen.points)
    row, view = np.full(count, -1), np.full(count, -1)
    place, normal = np.full((count, 2), np.nan), np.zeros((count, 3))
    order = np.argsort(seen.point, kind="stable")
    ends = np.cumsum(np.bincount(seen.point, minlength=count))
    for point, end in enumerate(ends):
        track = order[(ends[point - 1] if point else 0) : end]
        if len(track) < 2:
            continue
        seen_by = seen.view[track]
        towards = views.centres[seen_by] - seen.points[point]
        distance = np.linalg.norm(towards, axis=1)
        towards /= distance[:, None]
        pixel = distance / views.focals[seen_by]
        cosines = towards @ towards.T
        # Prefer a reference near the other photos' directions, and about as fine as they are.
        near = np.clip((cosines - WIDEST) / (NARROW - WIDEST), 0, 1)
        best = int((near * np.minimum(1, pixel[None, :] / pixel[:, None])).sum(axis=1).argmax())
        row[point], view[point] = track[best], seen_by[best]
        place[point] = seen.places[track[best]]
        mean = (towards * cosines[best].clip(0)[:, None]).sum(axis=0)
        normal[point] = mean / np.linalg.norm(mean)
    return _References(row=row, view=view, place=place, normal=normal)


def _wanted(
    views: Views,
    seen: Matches,
    references: _References,
    usable: NDArray[np.bool_],
    rng: np.random.Generator,
) -> _Wanted:
    """The tracks' other observations, and places in more photos that may show the points."""
    others = np.flatnonzero(references.row[seen.point] >= 0)
    others = others[references.row[seen.point[others]] != others]
    view, point, start = [seen.view[others]], [seen.point[others]], [seen.places[others]]
    points = np.flatnonzero(references.row >= 0)
    towards = views.centres[references.view[points]] - seen.points[points]
    distance = np.linalg.norm(towards, axis=1)
    pixel = distance / views.focals[references.view[points]]
    for row in map(int, np.flatnonzero(usable)):
        own = views.centres[row] - seen.points[points]
        own_distance = np.linalg.norm(own, axis=1)
        cosine = (own * towards).sum(axis=1) / (own_distance * distance)
        size = own_distance / views.focals[row] / pixel
        known = np.zeros(len(seen.points), dtype=bool)
        known[seen.point[seen.view == row]] = True
        may = (cosine > WIDEST) & (size > FINEST) & (size < COARSEST) & ~known[points]
        candidates = points[may]
        place = views.project(row, seen.points[candidates])
        lens = views.lenses[row]
        inside = (place > RIM).all(axis=1)
        inside &= (place < np.array([lens.width, lens.height]) - RIM).all(axis=1)
        some = rng.permutation(np.flatnonzero(inside))[:NEW_A_PHOTO]
        view.append(np.full(len(some), row))
        point.append(candidates[some])
        start.append(place[some])
    new = np.arange(sum(map(len, view))) >= len(others)
    return _Wanted(
        view=np.concatenate(view), point=np.concatenate(point), start=np.concatenate(start), new=new
    )


def _matched(
    views: Views,
    photos: Sequence[PhotoFile | None],
    points: Float64,
    references: _References,
    wanted: _Wanted,
    context: Context,
) -> tuple[Float64, NDArray[np.bool_]]:
    """Match the places in `wanted`: (M, 2) results, and (M,) whether they can be trusted."""
    count, started = len(wanted.view), time.monotonic()
    view_of = references.view[wanted.point]
    steps = _steps(views, points, references, wanted)
    patches = np.zeros((count, GRID.shape[1]), dtype=np.float16)  # half the memory of float32
    usable = np.zeros(count, dtype=bool)
    places, good = np.array(wanted.start), np.zeros(count, dtype=bool)
    damaged: set[int] = set()

    def match(view: int) -> None:
        """Match the wanted places of a photo, or take its patches as references."""
        rows = rows_of[view]
        file, lens = photos[view], views.lenses[view]
        assert file is not None
        photo = Pyramid(file.path, (lens.width, lens.height), file.turn)
        jacobians = views.jacobians(view, points[wanted.point[rows]], steps[rows])
        sound = np.isfinite(jacobians).all(axis=(1, 2))
        rows, jacobians = rows[sound], jacobians[sound]
        if turn == 0:
            places_there = references.place[wanted.point[rows]]
            patches[rows], usable[rows] = templates(photo, places_there, jacobians)
            return
        reach = np.where(wanted.new[rows], NEW_REACH, REACH)
        found, fits, likeness = align(
            photo, wanted.start[rows], jacobians, patches[rows].astype(np.float32), reach
        )
        places[rows] = found
        good[rows] = fits & (~wanted.new[rows] | (likeness > NEW_LIKENESS))

    memory = max((_bytes(file) for file in photos if file is not None), default=1)
    for turn, kinds in enumerate((view_of, wanted.view)):
        rows_of = {
            view: np.flatnonzero((kinds == view) & (usable | (turn == 0)))
            for view, file in enumerate(photos)
            if file is not None and view not in damaged
        }
        shown = [view for view, rows in rows_of.items() if len(rows)]
        # Each photo has its own rows, so threads write to different places.
        with in_parallel(match, shown, memory, context) as work:
            for view, job in work:
                try:
                    job.result()
                except PhotoError as error:
                    context.warn(f"{error.message} It is left out of matching.")
                    damaged.add(view)
                done = turn * len(photos) + view + 1
                context.progress("match points", done, 2 * len(photos), started)
    return places, good


def _bytes(file: PhotoFile) -> int:
    """The most bytes that matching in a photo takes."""
    try:
        size = photo_size(file.path)
    except PhotoError:  # reported when the photo is read
        return 1
    return decoding_bytes(file.path, size) + PYRAMID * size[0] * size[1]


def _steps(views: Views, points: Float64, references: _References, wanted: _Wanted) -> Float64:
    """(M, 3, 2) steps between samples of a patch, in its plane: a pixel of the coarser photo."""
    normal = references.normal[wanted.point]
    aside = np.where(np.abs(normal[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(normal, aside)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    size = np.zeros(len(normal))
    for which in (wanted.view, references.view[wanted.point]):
        for view in np.unique(which):
            rows = which == view
            own = views.footprints(int(view), points[wanted.point[rows]])
            size[rows] = np.maximum(size[rows], own)
    return np.asarray(np.stack([first, np.cross(normal, first)], axis=2) * size[:, None, None])


class Views:
    """V registered photos, in the order of their ids.

    Attributes:
        ids: of the images.
        lenses: the camera of each, pycolmap's.
        focals: (V,) mean focal lengths, px.
        centres: (V, 3) in the world.
    """

    def __init__(self, scene: Any) -> None:
        self.ids: list[int] = sorted(scene.reg_image_ids())
        self.lenses = [scene.images[key].camera for key in self.ids]
        self.focals = np.array([lens.mean_focal_length() for lens in self.lenses])
        self._poses = np.array(
            [np.asarray(scene.images[key].cam_from_world().matrix()) for key in self.ids]
        ).reshape(-1, 3, 4)
        turned = self._poses[:, :, :3].transpose(0, 2, 1)
        self.centres: Float64 = -(turned @ self._poses[:, :, 3:])[..., 0]

    def project(self, view: int, points: Float64) -> Float64:
        """(N, 3) points -> (N, 2) places in a photo, px; NaN behind the camera."""
        local = points @ self._poses[view, :, :3].T + self._poses[view, :, 3]
        local[local[:, 2] <= 0] = np.nan
        return np.asarray(np.asarray(self.lenses[view].img_from_cam(local)).reshape(-1, 2))

    def footprints(self, view: int, points: Float64) -> Float64:
        """(N,) size of the photo's pixel at each point, world units."""
        depths = points @ self._poses[view, 2, :3] + self._poses[view, 2, 3]
        return np.asarray(depths / self.focals[view])

    def jacobians(self, view: int, points: Float64, axes: Float64) -> Float64:
        """(N, 2, 2) the photo's px for two short steps from each point, as columns.

        `points`: (N, 3); `axes`: (N, 3, 2) the steps, as columns, world units.
        """
        centre = self.project(view, points)
        steps = [self.project(view, points + axes[:, :, k]) - centre for k in range(2)]
        return np.stack(steps, axis=2)
