"""Sets the SH learning rate by the measured view dependence of colours (ours).

View dependence is one minus the ratio of nugget and sill of a variogram (Matheron 1963;
docs/method.md, "View dependence").
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...context import QUIET, Context
from ...model.roi import OrientedBox
from ...model.scene import Float64, PosedImage, project
from ..config import Mechanism, TrainConfig

if TYPE_CHECKING:
    from ...cuda.photos import Photos
    from ..stage_data import StageData

RADIUS = 2  # px around a point; the mean of these pixels is its colour
LEAST = 5  # least photos that must observe a point
MOST = 64  # most photos of a point that are compared
SAME_SCALE = 1.5  # photos whose scales of a point differ more show other texture
ENOUGH_POINTS, MOST_POINTS = 50, 2000
TRIMMED = 0.9  # share of the sightings kept; points hidden or wrong in a photo differ most
FULL_RATE = 0.5  # predicted share from which SH learn at the full rate
POINTS_AT_ONCE = 250

# One row per point and photo: row of the point, colour (3), direction (3), pixels per world unit
Sightings = NDArray[np.float64]
POINT, COLOUR, DIRECTION, SCALE = 0, slice(1, 4), slice(4, 7), 7


@dataclass(frozen=True, kw_only=True)
class MeasuredShRate(Mechanism):
    """Lowers `lr_shN`, at least to 3DGS's, unless photos show that colours depend on the view.

    Points in the boxes are compared, or all observed points if these are too few. If too few photos
    observe the same points, as with a dozen photos from all sides, nothing constrains SH between
    them, and the rate is 3DGS's. A model without observations keeps the full rate.

    Earns: +0.23 dB in the silhouettes, +0.36 dB in the near third. Draft, six boxes of kumamon,
        flowerpot and the demo, two seeds (notebook/leave_one_out.md).
    """

    name: ClassVar[str] = "measured_sh_rate"

    def measured(self, config: TrainConfig, data: StageData, context: Context) -> TrainConfig:
        """Set the rate by the photos; PhotoError if one cannot be read."""
        full, least = config.lr_shN, TrainConfig.lr_shN
        if full <= least or not any(len(image.point_indices) for image in data.images):
            return config
        share = predicted_share(data.images, data.photos, data.points, data.rois, context)
        if share is None:
            share, why = (
                0.0,
                f"Too few points are seen by {LEAST} photos to measure view dependence.",
            )
        elif share < FULL_RATE:
            share = max(share, 0.0)
            why = (
                "Colours depend little on the view: neighbouring photos predict "
                f"{share:.0%} of the differences."
            )
        else:
            return config
        rate = least * (full / least) ** (share / FULL_RATE)
        context.info(f"{why} The SH learning rate is {rate:.2g}, not {full:.2g}.", "detail")
        return replace(config, lr_shN=rate)


def predicted_share(
    images: Sequence[PosedImage],
    photos: Photos,
    points: Float64,  # (P, 3)
    rois: Sequence[OrientedBox],
    context: Context = QUIET,
) -> float | None:
    """Return the share of the variance of points' colours predicted by the neighbouring photo.

    It is at most 1, and about 0 or below if colours do not depend on the view.

    Args:
        images, photos: the photos and their pixels, in the same order.
        points: (P, 3) that `images` observe, world units.
        rois: the boxes; their points are compared, or all if these are too few.
        context: checked for cancellation.

    Returns:
        The share; None if too few points are observed by enough photos.

    Raises:
        PhotoError: a photo cannot be read.
    """
    counts = np.zeros(len(points), dtype=np.int64)
    for image in images:
        counts[image.point_indices] += 1
    usable = counts >= LEAST
    boxed = usable & np.any([roi.contains(points) for roi in rois], axis=0) if rois else usable
    chosen = np.flatnonzero(boxed if boxed.sum() >= ENOUGH_POINTS else usable)
    if len(chosen) < ENOUGH_POINTS:
        return None
    chosen = chosen[:: -(-len(chosen) // MOST_POINTS)]
    sightings = _sightings(images, photos, points, chosen, context)
    parts = [_variances(group) for group in _groups(sightings)]
    if not parts:
        return None
    near, all_ = (np.concatenate(part) for part in zip(*parts, strict=True))
    if len(all_) < ENOUGH_POINTS:
        return None
    kept = all_ <= np.quantile(all_, TRIMMED)
    sill = float(all_[kept].sum())
    return 1 - float(near[kept].sum()) / sill if sill > 0 else None


def _sightings(
    images: Sequence[PosedImage],
    photos: Photos,
    points: Float64,
    chosen: NDArray[np.int64],
    context: Context,
) -> Sightings:
    """(S, 8) sightings of the chosen points, point by point, with photos in their order."""
    wanted, rows = np.zeros(len(points), dtype=bool), []
    wanted[chosen] = True
    offsets = np.arange(-RADIUS, RADIUS + 1)
    for index, image in enumerate(images):
        context.check_cancelled()
        own = image.point_indices[wanted[image.point_indices]]
        camera = image.camera
        pixels, depths, inside = project(points[own], camera, image.world_to_camera)
        pixels, size = np.floor(pixels), np.array([camera.width, camera.height])
        inside &= ((pixels >= RADIUS) & (pixels < size - RADIUS)).all(axis=1)
        if not inside.any():
            continue
        own, depths = own[inside], depths[inside]
        x, y = pixels[inside].astype(np.int64).T[..., None, None]
        across, down = x + offsets[None, None, :], y + offsets[None, :, None]
        patches = np.asarray(photos[index])[down, across].astype(np.float64)
        rays = image.centre - points[own]
        rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
        row = [own, patches[..., :3].mean(axis=(1, 2)), rays, camera.fx / depths]
        counted = (patches[..., 3:] == 255).all(axis=(1, 2, 3))  # a mask's pixels, if it has one
        rows.append(np.column_stack(row)[counted])
    found: Float64 = np.concatenate(rows) if rows else np.zeros((0, 8))
    return found[np.argsort(found[:, POINT], kind="stable")]


def _groups(sightings: Sightings) -> Iterator[NDArray[np.float64]]:
    """Yield (P, N, 8) sightings of some points at a time; NaN fills rows of points with fewer."""
    _, starts, counts = np.unique(sightings[:, POINT], return_index=True, return_counts=True)
    starts, counts = starts[counts >= LEAST], np.minimum(counts[counts >= LEAST], MOST)
    order = np.argsort(counts, kind="stable")
    for begin in range(0, len(order), POINTS_AT_ONCE):
        part = order[begin : begin + POINTS_AT_ONCE]
        column = np.arange(counts[part].max())
        rows = np.minimum(starts[part, None] + column, len(sightings) - 1)
        group = sightings[rows]
        group[column >= counts[part, None]] = np.nan
        yield group


def _variances(group: NDArray[np.float64]) -> tuple[Float64, Float64]:
    """Return for each sighting its variance with the nearest photo, and with all other photos.

    Only photos that show a point at a similar scale are compared; sightings with too few such
    photos are left out.
    """
    colour, ray, scale = group[..., COLOUR], group[..., DIRECTION], np.log(group[..., SCALE])
    with np.errstate(invalid="ignore"):
        alike = np.abs(scale[:, :, None] - scale[:, None, :]) <= np.log(SAME_SCALE)  # no NaN
    alike &= ~np.eye(group.shape[1], dtype=bool)
    cosine = np.where(alike, np.einsum("pic,pjc->pij", ray, ray), -2.0)
    half = np.zeros(alike.shape)
    for channel in range(3):
        half += (colour[:, :, None, channel] - colour[:, None, :, channel]) ** 2 / 6
    nearest = np.take_along_axis(half, cosine.argmax(axis=2)[..., None], axis=2)[..., 0]
    count = alike.sum(axis=2)
    enough = count >= LEAST - 1
    mean = np.where(alike, half, 0.0).sum(axis=2) / np.maximum(count, 1)
    return nearest[enough], mean[enough]
