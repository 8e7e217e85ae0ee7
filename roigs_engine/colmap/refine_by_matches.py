"""Refines cameras with matched tracks, which are more exact than keypoints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..context import Context
from ..formats.text import counted, named
from ..photos.files import PhotoFolder
from ..photos.headers import PhotoError, photo_size
from ..photos.rotation import AS_STORED, turned_size
from . import adjustment
from .records import same_shape
from .track_matching import Matches, PhotoFile, Views, match_tracks

LOSS_SCALE = 0.3  # px: most matches have errors below 0.1
FEW = 50  # matches: photos with fewer also keep their keypoints
MANY = 100  # matches: photos with this many or more may have their own focal length
POSES, DISTORTION, FOCAL_LENGTHS = CHANGES = ("poses", "distortion", "focal lengths")
CLEARLY = 0.97  # more parameters must reduce the error by at least this factor


@dataclass(frozen=True, kw_only=True)
class MatchedFit:
    """The fit of cameras to matched tracks.

    Attributes:
        before, after: median error of left-out matches with the old and the new cameras, px.
        left_out: their number.
        matches, photos: numbers of matches, and of photos with matches.
        changed: the groups of parameters whose change made the left-out matches fit better.

    Errors are NaN if there are too few matches to compare.
    """

    before: float
    after: float
    left_out: int
    matches: int
    photos: int
    changed: tuple[str, ...] = ()

    @property
    def better(self) -> bool:
        """Whether the new cameras fit better; only then are they used."""
        return bool(self.changed)

    @property
    def enough(self) -> bool:
        """Whether there were enough matches to compare."""
        return self.left_out >= adjustment.FEWEST_LEFT_OUT


def photo_files(
    scene: Any,
    folder: PhotoFolder,
    names: Mapping[int, str],
    turns: Mapping[int, int],
    context: Context,
) -> list[PhotoFile | None]:
    """The file of each of `Views(scene).ids`; None for unusable ones, with a warning.

    `names`, `turns`: of the photos by their ids; see `project.model_turns`.
    """
    found: list[PhotoFile | None] = []
    views = Views(scene)
    for key, lens in zip(views.ids, views.lenses, strict=True):
        path, turn = folder.find(names[key]), turns.get(key, AS_STORED)
        fits = False
        with suppress(PhotoError):
            if path is not None:
                size = turned_size(photo_size(path), turn)
                fits = same_shape((lens.width, lens.height), size)
        found.append(PhotoFile(path, turn) if path is not None and fits else None)
    unused = [names[key] for key, file in zip(views.ids, found, strict=True) if file is None]
    if unused:
        context.warn(
            f"{counted(len(unused), 'photo')} not used: missing, damaged, or of another shape "
            f"than the camera ({named(unused)})."
        )
    return found


def fit_to_matches(
    colmap: Any, scene: Any, photos: Sequence[PhotoFile | None], context: Context
) -> tuple[Any, MatchedFit]:
    """Match the tracks of a scene, and fit its cameras and poses to them.

    There are three steps: cameras and poses, then more parameters of distortion, then a focal
    length for each photo. One match of every third point with a long track is left out. A step is
    kept if these matches then fit better, with points fitted to the other matches.

    Args:
        colmap: the module pycolmap.
        scene: its reconstruction; not changed.
        photos: the file of each of `Views(scene).ids`.

    Returns:
        A scene of the same photos with the cameras that fit best, and the fit. The photos may lose
        their names, and only matched points remain.
    """
    matches = match_tracks(scene, photos, context)
    tracked = colmap.Reconstruction(scene)
    anchors = _track(colmap, tracked, scene, matches)
    left_out = adjustment.to_leave_out(tracked, anchors)
    fit = MatchedFit(
        before=math.nan,
        after=math.nan,
        left_out=len(left_out),
        matches=len(matches.view),
        photos=len(np.unique(matches.view)),
    )
    if not fit.enough:
        return scene, fit
    for image, keypoint, _ in left_out:
        tracked.delete_observation(image, keypoint)
    trial = colmap.Reconstruction(tracked)
    adjustment.adjust(colmap, trial, "CAUCHY", LOSS_SCALE, points_only=True)
    before = best = adjustment.median_error(trial, left_out)
    found, taken = tracked, []
    for change in CHANGES:
        context.check_cancelled()
        if change == FOCAL_LENGTHS and adjustment.has_rigs(scene):
            continue
        trial = colmap.Reconstruction(found)
        if change == DISTORTION and not adjustment.with_fuller_cameras(
            colmap, trial, adjustment.FULLEST
        ):
            continue
        if change == FOCAL_LENGTHS:
            ids, counts = Views(scene).ids, np.bincount(matches.view)
            often = {ids[view] for view in np.flatnonzero(counts >= MANY)}
            trial = adjustment.with_own_cameras(colmap, trial, often)
        adjustment.adjust(colmap, trial, "CAUCHY", LOSS_SCALE, distortion=change != FOCAL_LENGTHS)
        error = adjustment.median_error(trial, left_out)
        if not all(map(adjustment.is_sound, trial.cameras.values())):
            continue
        if error < best * (1 if change == POSES else CLEARLY):
            best, found = error, trial
            taken.append(change)
    fit = replace(fit, before=before, after=best, changed=tuple(taken))
    return (found if taken else scene), fit


def _track(colmap: Any, target: Any, scene: Any, matches: Matches) -> set[tuple[int, int]]:
    """Replace a reconstruction's keypoints and tracks by the matches.

    Returns the references as ids of photo and keypoint.
    """
    views = Views(scene)
    target.delete_all_points2D_and_points3D()
    keypoints: list[list[Any]] = [[] for _ in views.ids]
    tracks: dict[int, list[adjustment.Observation]] = {}
    anchors = set()
    for row, point in enumerate(matches.point.tolist()):
        view = int(matches.view[row])
        place = (views.ids[view], len(keypoints[view]))
        keypoints[view].append(colmap.Point2D(matches.places[row]))
        tracks.setdefault(point, []).append((*place, point))
        if matches.reference[row]:
            anchors.add(place)
    row_of = {key: row for row, key in enumerate(sorted(scene.point3D_ids()))}
    for image, own in zip(views.ids, keypoints, strict=True):
        if len(own) >= FEW:
            continue
        # Keep its own keypoints of matched points, unless the point has a match in this photo.
        for keypoint in scene.images[image].points2D:
            if not keypoint.has_point3D():
                continue
            point = row_of[keypoint.point3D_id]
            track = tracks.get(point, [])
            if track and all(other != image for other, _, _ in track):
                track.append((image, len(own), point))
                own.append(colmap.Point2D(keypoint.xy))
    for view, own in enumerate(keypoints):
        target.images[views.ids[view]].points2D = colmap.Point2DList(own)
    for point, track in sorted(tracks.items()):
        if len(track) > 1:
            elements = [colmap.TrackElement(image, keypoint) for image, keypoint, _ in track]
            target.add_point3D(matches.points[point], colmap.Track(elements))
    return anchors
