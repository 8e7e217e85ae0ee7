"""Visibility of a box in photos: the filter of the paper's sec. III-A.

A photo is a candidate if it observes at least one SfM point inside the box. Observations come from
the model's tracks. For a model without tracks, the points are projected, and their depth is
compared with that of the sparse points in front of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..errors import RoiError
from ..formats.text import counted
from .leaves import leaves_of
from .roi import OrientedBox
from .scene import Float64, Int64, PosedImage, SfmScene

NEAREST_NAMED = 3  # points listed in the error about an empty box
OTHER_UNITS = 3.0  # a box this many times as large as all points is in other units
# For the depth test without tracks: cells along the image's longer side; number of points in front
# that hide a point (a single one could be an outlier); how far in front they must be, in diagonals
# of the box, or in extents of the scene.
DEPTH_CELLS = 64
OCCLUDERS = 2
DEPTH_SLACK = 0.1
MAX_OCCLUDERS = 100_000  # scene points in the depth test
# Limits for a box: above these, only every second, third ... of its points is used.
MAX_POINTS, MAX_OBSERVATIONS = 100_000, 20_000_000
MAX_PROJECTED = 400_000_000  # occluders x photos: the same limit for the depth test
EVERYWHERE = np.full(2, -np.inf), np.full(2, np.inf)


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """The photos that see the box, and the points of the box that each photo sees.

    The visibility matrix A (A[v, p] = 1 if photo v observes point p) is stored as its non-zero
    entries, ordered by photo.

    Attributes:
        roi: the box.
        images: V photos in name order; methods identify a photo by its index here.
        points: (P, 3) the scene's points inside the box, world units.
        obs_view: (N,) photo of each observation, ascending.
        obs_point: (N,) row of `points` of each observation, ascending within a photo.
        flags: warnings about degenerate cases.
    """

    roi: OrientedBox
    images: tuple[PosedImage, ...]
    points: Float64
    obs_view: Int64
    obs_point: Int64
    flags: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.images)

    @property
    def names(self) -> tuple[str, ...]:
        """(V,) photo names, ascending."""
        return tuple(image.name for image in self.images)

    def centres(self) -> Float64:
        """(V, 3) camera centres in the world."""
        return np.array([image.centre for image in self.images]).reshape(-1, 3)

    def forwards(self) -> Float64:
        """(V, 3) unit viewing directions in the world."""
        return np.array([image.forward for image in self.images]).reshape(-1, 3)

    def thinned(self) -> Candidates:
        """The same photos with at most `MAX_POINTS` points and about `MAX_OBSERVATIONS`."""
        share = len(self.points) / MAX_POINTS, len(self.obs_view) / MAX_OBSERVATIONS
        step = math.ceil(max(share))
        if step == 1:
            return self
        kept = self.obs_point % step == 0
        return replace(
            self,
            points=self.points[::step],
            obs_view=self.obs_view[kept],
            obs_point=self.obs_point[kept] // step,
        )

    def row_starts(self) -> Int64:
        """(V + 1,) starts: photo v has the observations from row_starts[v] to row_starts[v + 1]."""
        return np.searchsorted(self.obs_view, np.arange(len(self) + 1)).astype(np.int64)


def observations(scene: SfmScene, roi: OrientedBox, context: Context = QUIET) -> Candidates:
    """Find the photos that see the box, and the points in it that each observes; may be empty."""
    rows = np.flatnonzero(roi.contains(scene.points)) if len(scene.points) else np.zeros(0, int)
    images = sorted(scene.images, key=lambda image: image.name)
    flags: tuple[str, ...] = ()
    if scene.has_tracks:
        position = np.full(len(scene.points), -1, dtype=np.int64)
        position[rows] = np.arange(len(rows))
        found = [position[image.point_indices] for image in images]
        seen = [np.unique(points[points >= 0]) for points in found]
    else:
        step = max(1, math.ceil(len(rows) * len(images) / MAX_OBSERVATIONS))
        rows = rows[::step]
        seen = _by_depth(
            images, scene.points[rows], scene.points, DEPTH_SLACK * roi.diagonal, context
        )
        some = f", one in {step} of those in the box," if step > 1 else ""
        flags = (
            f"The model stores no tracks: the sparse points{some} are projected to estimate which"
            " photos see the box.",
        )
    kept = [index for index, points in enumerate(seen) if len(points)]
    return Candidates(
        roi=roi,
        images=tuple(images[index] for index in kept),
        points=scene.points[rows],
        obs_view=np.repeat(np.arange(len(kept)), [len(seen[index]) for index in kept]),
        obs_point=np.concatenate([np.empty(0, np.int64), *(seen[index] for index in kept)]),
        flags=flags,
    )


def find_candidates(scene: SfmScene, roi: OrientedBox, context: Context = QUIET) -> Candidates:
    """Call `observations`; RoiError if no point is in the box, or no photo observes one."""
    check_has_points(scene, roi)
    found = observations(scene, roi, context)
    if not found.images:
        raise RoiError(
            f"No photo sees any of the points in box '{roi.name}'"
            f" ({counted(len(found.points), 'point')}, {counted(len(scene.images), 'photo')}).",
            "Use fewer test photos, or move or enlarge the box.",
        )
    return found


def check_has_points(scene: SfmScene, roi: OrientedBox) -> None:
    """Raise RoiError if no point is in the box; it names the box's size and the nearest points."""
    if roi.contains(scene.points).any():
        return
    finite = scene.points[np.isfinite(scene.points).all(axis=1)]
    sides = " x ".join(f"{2 * side:.4g}" for side in roi.half_extents)
    centre = _position(roi.centre)
    message = f"Box '{roi.name}' contains no sparse point (sides {sides}, centre {centre})."
    if len(finite) == 0:
        raise RoiError(
            f"{message} The model has no points at all.",
            "Export the COLMAP model with its points3D file.",
        )
    distance = roi.distance(finite)
    nearest = np.argsort(distance, kind="stable")[:NEAREST_NAMED]
    named = "; ".join(f"{distance[i]:.4g} away at {_position(finite[i])}" for i in nearest)
    size = float(np.linalg.norm(np.ptp(finite, axis=0)))
    if distance[nearest[0]] > roi.diagonal or roi.diagonal > OTHER_UNITS * size:
        hint = ". Is it in the model's units and frame?"
    else:
        hint = f", or enlarge it by {distance[nearest[0]]:.4g} or more on that side."
    raise RoiError(f"{message} Nearest points: {named}.", f"Move the box onto the object{hint}")


def visible_images(scene: SfmScene, roi: OrientedBox, context: Context = QUIET) -> tuple[str, ...]:
    """Names of the photos that see the box, in name order; raises as `find_candidates`."""
    return find_candidates(scene, roi, context).names


def observed_points(scene: SfmScene, context: Context = QUIET) -> list[Int64]:
    """For each photo, in the scene's order, the rows of the points that it observes, ascending."""
    if scene.has_tracks:
        return [np.unique(image.point_indices) for image in scene.images]
    slack = DEPTH_SLACK * scene.extent()
    return _by_depth(scene.images, scene.points, scene.points, slack, context)


def _by_depth(
    images: Sequence[PosedImage], targets: Float64, points: Float64, slack: float, context: Context
) -> list[Int64]:
    """For each photo, the ascending rows of the `targets` that it sees; for models without tracks.

    A photo sees a point if two conditions hold. The point projects into the image. In its cell
    (`DEPTH_CELLS` cells along the longer side), fewer than `OCCLUDERS` sparse points are in front
    of it by more than `slack` world units.
    """
    if not len(targets):
        return [np.zeros(0, np.int64)] * len(images)
    most = min(MAX_OCCLUDERS, max(1, MAX_PROJECTED // max(1, len(images))))
    occluders = _Occluders(points[:: -(-len(points) // most) or 1])
    places, last, seen = np.ascontiguousarray(targets.T), np.iinfo(np.uint16).max, []
    looked_at = np.zeros((DEPTH_CELLS + 1) ** 2, dtype=bool)  # cells that have a target
    for image in images:
        context.check_cancelled()
        rows, pixels, target_depth = _projected(image, places)
        if not len(rows):
            seen.append(rows)
            continue
        target_cell, size = _cells(image, pixels), _cell_size(image)
        looked_at[target_cell] = True
        # Do not sort occluders that are behind or beside all targets, as most are.
        window = pixels.min(axis=1) - size, pixels.max(axis=1) + size
        farthest = float(target_depth.max() - slack)
        near = occluders.near(image, farthest, window)
        _, pixels, depth = _projected(image, near, farthest, window)
        cell = _cells(image, pixels)
        kept = looked_at[cell]
        looked_at[target_cell] = False
        cell, depth = cell[kept], depth[kept]
        order = np.argsort(depth)
        order = order[np.argsort(cell[order], kind="stable")]  # radix sort for 16 bits
        counts = np.bincount(cell, minlength=len(looked_at))
        # An extra occluder behind all others stands for missing ones in a cell.
        cell, depth = np.append(cell[order], np.uint16(last)), np.append(depth[order], np.inf)
        starts = np.cumsum(counts) - counts
        nth = np.minimum(starts[target_cell] + OCCLUDERS - 1, len(cell) - 1)
        hidden = (cell[nth] == target_cell) & (depth[nth] < target_depth - slack)
        seen.append(rows[~hidden])
    return seen


class _Occluders:
    """Points in groups of neighbours: groups outside a photo's window are skipped."""

    def __init__(self, points: Float64) -> None:
        """Args: `points`: (N, 3), at least one."""
        groups = leaves_of(points)
        self._points = np.ascontiguousarray(points[np.concatenate(groups)].T)
        self._sizes = [len(group) for group in groups]
        low = np.array([points[group].min(axis=0) for group in groups])
        high = np.array([points[group].max(axis=0) for group in groups])
        self._centres = np.ascontiguousarray((low + high).T / 2)
        # Slightly larger than exact, because of rounding.
        self._radii = np.linalg.norm(high - low, axis=1) * (0.5 + 1e-6) + 1e-9 * np.abs(high).max()

    def near(self, image: PosedImage, farthest: float, window: tuple[Float64, Float64]) -> Float64:
        """(3, M) the points that `_projected` finds with the same arguments, and some more."""
        camera, pose, radii = image.camera, image.world_to_camera, self._radii
        x, y, depth = pose[:3, :3] @ self._centres + pose[:3, 3:]
        kept = (depth > -radii) & (depth < farthest + radii)
        axes = (x, camera.fx, camera.cx), (y, camera.fy, camera.cy)
        for axis, (across, focal, centre) in enumerate(axes):
            for sign, bound in zip((1, -1), (low_high[axis] for low_high in window), strict=True):
                slope = bound - centre
                beyond = sign * (across * focal - depth * slope)  # 0 on the plane of the bound
                kept &= beyond >= -radii * math.hypot(focal, slope)
        return self._points.take(np.flatnonzero(np.repeat(kept, self._sizes)), axis=1)


def _projected(
    image: PosedImage,
    points: Float64,
    farthest: float = np.inf,
    window: tuple[Float64, Float64] = EVERYWHERE,
) -> tuple[Int64, Float64, Float64]:
    """World positions (3, N) -> those in the image: rows (M,), pixels (2, M), depths (M,).

    Only those with a depth less than `farthest`, and inside a window, given by its lowest and
    highest pixels (2,).
    """
    camera, pose = image.camera, image.world_to_camera
    local = pose[:3, :3] @ points + pose[:3, 3:]
    rows = np.flatnonzero((local[2] > 0) & (local[2] < farthest))
    x, y, depth = (values[rows] for values in local)
    with np.errstate(all="ignore"):  # points at the camera
        x, y = x / depth * camera.fx + camera.cx, y / depth * camera.fy + camera.cy
    (left, top), (right, bottom) = window
    within = (x >= max(left, 0)) & (x < camera.width) & (x <= right)
    within &= (y >= max(top, 0)) & (y < camera.height) & (y <= bottom)
    kept = np.flatnonzero(within)
    return rows[kept], np.stack([x[kept], y[kept]]), depth[kept]


def _cell_size(image: PosedImage) -> float:
    """Side of a cell of the depth test, pixels."""
    return max(image.camera.width, image.camera.height) / DEPTH_CELLS


def _cells(image: PosedImage, pixels: Float64) -> NDArray[np.uint16]:
    """(2, N) pixels in the image -> (N,) cells of the depth test."""
    x, y = np.floor(pixels / _cell_size(image))
    return np.asarray((y * (DEPTH_CELLS + 1) + x).astype(np.uint16))


def _position(point: Float64) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in point) + ")"
