"""Exposures of a scene's photos, from EXIF (checked against the photos) or from sparse points.

A point has one colour, so its brightness in the photos shows their exposures. EXIF is more exact.
But EXIF does not change when a program brightens photos; levelling by it would then be wrong by
stops. So EXIF is used only if photos agree better with it, or if they share too few points to tell.
It is never used if exposures differ by more than those of any scene. Without EXIF, exposures are
solved from the points, and shrunk towards 0 if the solutions of two halves of the points disagree.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..errors import RunFolderError
from ..formats.files import read_record, write_json
from ..formats.run_files import EXPOSURES
from ..formats.text import counted, json_digest, named
from ..model.scene import Float64, Int64, PosedImage, SfmScene, project
from ..photos.exposures import CLIPPED, LEAST_SPREAD, MOST_STOPS, relative_exposures

KEYS = ("key", "stops")  # of the file
VERSION = 2  # increase it if the same photos get other exposures
SIDE = 256  # pixels: the photos are reduced to this side
DARK, BRIGHT = 8, 245  # of 255: values outside say little about the light
LEAST_PAIRS = 100  # of observations, needed to check EXIF
MOST_SPREAD = 12.0  # stops of the photos of a scene, from a cellar to sunlight
ROUNDS = 20  # of medians of points, then of photos; they converge in about ten
EXIF, POINTS = "EXIF", "points"


@dataclass(frozen=True, kw_only=True)
class Observed:
    """The brightness of points in the photos that observe them.

    Attributes:
        photo, point: (N,) rows of photos and of points.
        light: (N,) log2 of the linear light there.
    """

    photo: Int64
    point: Int64
    light: Float64

    def among(self, chosen: NDArray[np.bool_]) -> Observed:
        """The observations selected by the mask `chosen` (N,)."""
        return Observed(
            photo=self.photo[chosen], point=self.point[chosen], light=self.light[chosen]
        )


def with_exposures(
    scene: SfmScene, cache: Path | None, *, pixels: bool, context: Context = QUIET
) -> SfmScene:
    """Add to the scene's photos the exposures by which they are levelled.

    Args:
        cache: folder in which the result is kept; None: it is not kept.
        pixels: whether photos can be decoded; if not, only a result in the cache is used.

    Raises:
        PhotoError: a photo cannot be decoded.
        Stopped: on request.
    """
    exif = relative_exposures({image.name: image.exif_exposure for image in scene.images})
    digests = [image.digest for image in scene.images]
    key = json_digest([VERSION, exif, digests, scene.digest()])
    found = _remembered(cache, key)
    if found is None:
        if not pixels:
            return scene
        found = _found(scene, exif, context)
        if cache is not None:
            with suppress(RunFolderError):  # the file only saves time
                write_json(cache / EXPOSURES, {"key": key, "stops": found}, durable=False)
    if pixels:
        _tell(scene, found, exif, context)
    images = tuple(_with_exposure(image, found.get(image.name, 0.0)) for image in scene.images)
    return replace(scene, images=images)


def _found(scene: SfmScene, exif: Mapping[str, float], context: Context) -> dict[str, float]:
    """Photo -> stops, for the photos to level."""
    observed = observe(scene, context)
    stops = np.array([exif.get(image.name, 0.0) for image in scene.images])
    if exif and np.ptp(stops) <= MOST_SPREAD and agrees(observed, stops):
        return dict(exif)
    solved = solve(observed, len(scene.images))
    return {
        image.name: round(float(value), 4)
        for image, value in zip(scene.images, solved, strict=True)
        if value
    }


def observe(scene: SfmScene, context: Context = QUIET) -> Observed:
    """The brightness of a scene's points in its photos, without dark or clipped pixels."""
    parts = []
    for row, image in enumerate(scene.images):
        context.check_cancelled()
        points, light = _observed_light(image, scene.points)
        parts.append((np.full(len(points), row), points, light))
    photo, point, light = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Observed(photo=photo, point=point, light=light)


def _observed_light(image: PosedImage, points: Float64) -> tuple[Int64, Float64]:
    from ..photos.decode import load_as_taken
    from ..photos.profiles import srgb_curve

    small = replace(image, camera=image.camera.thumbnail(SIDE), whole_size=None)
    pixels = load_as_taken(small)
    at, _, within = project(points[image.point_indices], small.camera, image.world_to_camera)
    rows, at = image.point_indices[within], at[within].astype(int)
    values = pixels[at[:, 1], at[:, 0]]
    good = ((values > DARK) & (values < BRIGHT)).all(axis=1)
    light = srgb_curve(values[good] / 255.0).mean(axis=1)
    return rows[good], np.log2(light)


def agrees(observed: Observed, stops: Float64) -> bool:
    """Whether points look more equal in photos that are levelled by `stops` (V,).

    True also with too few pairs of observations to check this.
    """
    order = np.argsort(observed.point, kind="stable")
    same = np.diff(observed.point[order]) == 0
    apart = np.diff(stops[observed.photo[order]])
    pairs = same & (np.abs(apart) >= LEAST_SPREAD)
    if pairs.sum() < LEAST_PAIRS:
        return True
    plain = np.diff(observed.light[order])[pairs]
    return bool(np.median(np.abs(plain - apart[pairs])) < np.median(np.abs(plain)))


def solve(observed: Observed, photos: int) -> Float64:
    """Solve the photos' stops (V,) from their points; zeros if they do not differ for certain.

    The light at a point in a photo is the product of the point's and the photo's light. Medians in
    turn solve for both. Two halves of the points, solved separately, show how much of a difference
    is chance.
    """
    stops = _solved(observed, photos)
    even = observed.point % 2 == 0
    halves = [_solved(observed.among(half), photos) for half in (even, ~even)]
    chance = float(np.var(halves[0] - halves[1])) / 4  # variance of the mean of both halves
    spread = float(np.var(stops))
    if spread < LEAST_SPREAD**2:
        return np.zeros(photos)
    return stops * max(0.0, 1 - chance / spread)


def _solved(observed: Observed, photos: int) -> Float64:
    stops = np.zeros(photos)
    for _ in range(ROUNDS):
        points = _medians(observed.light - stops[observed.photo], observed.point)
        stops = _medians(observed.light - points[observed.point], observed.photo, photos)
        stops -= np.median(stops)
    return stops


def _medians(values: Float64, groups: Int64, count: int = 0) -> Float64:
    """(G,) medians of the values (N,) in each group, numbered from 0; 0 for empty groups."""
    order = np.lexsort((values, groups))
    ordered, members = values[order], groups[order]
    numbers = np.arange(max(count, int(members[-1]) + 1 if len(members) else 0))
    first, end = (np.searchsorted(members, numbers, side) for side in ("left", "right"))
    medians = np.zeros(len(numbers))
    filled = end > first
    low, high = (first[filled] + end[filled] - 1) // 2, (first[filled] + end[filled]) // 2
    medians[filled] = (ordered[low] + ordered[high]) / 2
    return medians


def _with_exposure(image: PosedImage, stops: float) -> PosedImage:
    if not stops:
        return image
    digest = image.digest and f"{image.digest}-{stops:+.4f}-{CLIPPED}"
    return replace(image, exposure=stops, digest=digest)


def _remembered(cache: Path | None, key: str) -> dict[str, float] | None:
    record = read_record(cache / EXPOSURES) if cache is not None else {}
    stops = record.get("stops")
    if record.get("key") != key or not isinstance(stops, dict):
        return None
    good = all(isinstance(value, float) and abs(value) <= MOST_STOPS for value in stops.values())
    return stops if good else None


def _tell(
    scene: SfmScene, found: Mapping[str, float], exif: Mapping[str, float], context: Context
) -> None:
    """Report the source and the range of exposures; warn of wrong or missing EXIF."""
    believed = bool(found) and found == exif
    if exif and not believed:
        spread = np.ptp([*exif.values()])
        why = "as in no scene" if spread > MOST_SPREAD else "but the photos do not"
        context.warn(f"Exposures in EXIF differ by {spread:.1f} stops, {why}: EXIF is not used.")
    if found:
        source = EXIF if believed else POINTS
        context.info(
            f"Exposures differ by {np.ptp([*found.values()]):.1f} stops ({source}): photos are"
            " levelled in linear light."
        )
    unknown = [image.name for image in scene.images if believed and image.name not in exif]
    if unknown:
        context.warn(
            f"{counted(len(unknown), 'photo')} without an exposure in EXIF, used as they are:"
            f" {named(unknown)}."
        )
