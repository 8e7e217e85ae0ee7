"""Cameras from matched tracks: photos are looked at, to see their points where they really are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..context import Context
from ..photos.files import PhotoFolder
from ..photos.headers import photo_size
from .adjustment import Observation, adjust, median_error, to_leave_out
from .lenses import with_fullest_cameras, with_own_cameras
from .matching.tracks import Matches, match_tracks
from .matching.views import Views
from .records import same_shape

LOSS_SCALE, KEYPOINT_SCALE = 0.3, 1.0  # px: most matches are better than 0.1, keypoints than 0.5
FEW = 50  # matches: a photo with fewer keeps its keypoints beside them
MANY = 100  # matches: a photo with more may have a focal length of its own
FEWEST_LEFT_OUT = 50  # matches to compare by
CLEARLY = 0.97  # of the error before: more parameters must bring that much


@dataclass(frozen=True, kw_only=True)
class MatchedFit:
    """How well cameras fit matched tracks.

    Attributes:
        before, after: median error of left-out matches with the old and the new cameras, px.
        left_out: their number.
        matches, photos: how many places were matched, and in how many photos.
        changed: what was allowed to change, and made the left-out matches fit better.
    """

    before: float
    after: float
    left_out: int
    matches: int
    photos: int
    changed: tuple[str, ...]

    @property
    def better(self) -> bool:
        """Whether the new cameras fit better; only then they were taken."""
        return bool(self.changed)


def photo_paths(scene: Any, folder: PhotoFolder, names: dict[int, str]) -> list[Path | None]:
    """The file of each of `Views(scene).ids`; None: it is missing, or not of the camera's shape."""
    found: list[Path | None] = []
    for key, lens in zip(Views(scene).ids, Views(scene).lenses, strict=True):
        path = folder.find(names[key])
        size = None if path is None else photo_size(path)
        fits = size is not None and same_shape((lens.width, lens.height), size)
        found.append(path if fits else None)
    return found


def fit_to_matches(
    colmap: Any, scene: Any, photos: Sequence[Path | None], context: Context
) -> tuple[Any, MatchedFit | None]:
    """Match the tracks of a scene, and fit its cameras and poses to them.

    More and more may change: cameras and poses, then more parameters of distortion, then a focal
    length for each photo. Of every third point with a long track, one match is left out. Each step
    is kept if these then fit better, with points that fit the other matches best.

    Args:
        colmap: the module pycolmap.
        scene: its reconstruction; not changed.
        photos: the file of each of `Views(scene).ids`.
        context: receives progress; checked for cancellation.

    Returns:
        The scene with its tracks and the cameras that fit best, its points where they then fit
        (names of photos may be cut at spaces); and what was done. None: there are too few matches
        to judge by.

    Raises:
        Stopped: on request.
    """
    matches = match_tracks(scene, photos, context)
    tracked = colmap.Reconstruction(scene)
    anchors = _track(colmap, tracked, scene, matches)
    left_out = to_leave_out(tracked, anchors)
    if len(left_out) < FEWEST_LEFT_OUT:
        return scene, None
    for image, keypoint, _ in left_out:
        tracked.delete_observation(image, keypoint)
    trial = colmap.Reconstruction(tracked)
    adjust(colmap, trial, "CAUCHY", LOSS_SCALE, points_only=True)
    before = best = median_error(trial, left_out)
    found, changes = None, ("poses", "distortion", "focal lengths")
    trial, taken = tracked, []
    for change in changes:
        context.check_cancelled()
        trial = colmap.Reconstruction(trial if found is None else found)
        if change == "distortion" and not with_fullest_cameras(colmap, trial):
            continue
        if change == "focal lengths":
            trial = with_own_cameras(colmap, trial, _often_matched(views_of(matches, scene)))
        adjust(colmap, trial, "CAUCHY", LOSS_SCALE, distortion=change != "focal lengths")
        error = median_error(trial, left_out)
        if error < CLEARLY * best or (change == "poses" and error < best):
            best, found = error, trial
            taken.append(change)
    fit = MatchedFit(
        before=before,
        after=best,
        left_out=len(left_out),
        matches=len(matches.view),
        photos=len(np.unique(matches.view)),
        changed=tuple(taken),
    )
    return (scene if found is None else _moved(colmap, scene, found)), fit


def _often_matched(counts: dict[int, int]) -> set[int]:
    """The photos that get a focal length of their own."""
    return {key for key, count in counts.items() if count >= MANY}


def views_of(matches: Matches, scene: Any) -> dict[int, int]:
    """Id of each photo -> the number of its matches."""
    views = Views(scene)
    counts = np.bincount(matches.view, minlength=len(views.ids))
    return dict(zip(views.ids, counts.tolist(), strict=True))


def _moved(colmap: Any, scene: Any, fitted: Any) -> Any:
    """The scene with another's cameras and poses, and its points where they then fit."""
    own = {key for key, image in fitted.images.items() if image.camera_id not in scene.cameras}
    moved = with_own_cameras(colmap, scene, own) if own else colmap.Reconstruction(scene)
    for key, image in fitted.images.items():
        camera = moved.cameras[moved.images[key].camera_id]
        camera.model, camera.params = image.camera.model, image.camera.params
        frame = moved.frames[moved.images[key].frame_id]
        frame.set_cam_from_world(moved.images[key].camera_id, image.cam_from_world())
    adjust(colmap, moved, "CAUCHY", KEYPOINT_SCALE, points_only=True)
    return moved


def _track(colmap: Any, target: Any, scene: Any, matches: Matches) -> set[tuple[int, int]]:
    """Give a reconstruction the matches in place of the scene's keypoints and tracks.

    Returns:
        Ids of the photos and keypoints of the references.
    """
    views = Views(scene)
    target.delete_all_points2D_and_points3D()
    keypoints: list[list[Any]] = [[] for _ in views.ids]
    tracks: dict[int, list[Observation]] = {}
    anchors = set()
    for row, point in enumerate(matches.point.tolist()):
        view = int(matches.view[row])
        place = (views.ids[view], len(keypoints[view]))
        keypoints[view].append(colmap.Point2D(matches.places[row]))
        tracks.setdefault(point, []).append((*place, point))
        if matches.reference[row]:
            anchors.add(place)
    keys = sorted(scene.point3D_ids())
    few = [view for view, own in enumerate(keypoints) if len(own) < FEW]
    for view in few:
        _keep_keypoints(colmap, scene, views.ids[view], keypoints[view], tracks, keys)
    for view, own in enumerate(keypoints):
        target.images[views.ids[view]].points2D = colmap.Point2DList(own)
    for point, track in sorted(tracks.items()):
        if len(track) > 1:
            elements = [colmap.TrackElement(image, keypoint) for image, keypoint, _ in track]
            target.add_point3D(matches.points[point], colmap.Track(elements))
    return anchors


def _keep_keypoints(
    colmap: Any,
    scene: Any,
    image: int,
    keypoints: list[Any],
    tracks: dict[int, list[Observation]],
    keys: Sequence[int],
) -> None:
    """Add the scene's own keypoints of a photo to those of matched points; no point has two."""
    row_of = {key: row for row, key in enumerate(keys)}
    for keypoint in scene.images[image].points2D:
        if not keypoint.has_point3D():
            continue
        point = row_of[keypoint.point3D_id]
        track = tracks.get(point, [])
        if track and all(other != image for other, _, _ in track):
            track.append((image, len(keypoints), point))
            keypoints.append(colmap.Point2D(keypoint.xy))
