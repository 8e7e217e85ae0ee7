"""Measures sharpness and exposure of each photo at a box, from the pixels around its patches.

Two values are measured for each patch p in each photo v that sees it. One is the energy L of the
Laplacian, divided by the squared brightness, so that a dark photo does not count as blurred. The
other is the light Y. Each patch has a different texture, and a nearer photo shows finer parts of
it. So photos are compared by a model with two effects. It is fitted by medians, which a few odd
patches do not change:

    log L(p, v) = texture_p + k log rho(p, v) + sharp_v
    log Y(p, v) = light_p + exposure_v

Photos have a spectrum near 1/f, so L grows with the fourth power of the finest remaining frequency.
So a photo's resolution is reduced by the fourth root of the ratio of its L to that of sharp photos.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..colmap.lenses import photo_places
from ..context import QUIET, Context
from ..model.scene import Float64, PosedImage, project
from ..photos.decode import load_photo
from ..photos.headers import PhotoError
from ..photos.mask_images import load_mask
from ..photos.parallel import decoding_bytes, in_parallel
from ..photos.profiles import srgb_curve
from .patches import Patches

SIDE = 1600  # longest side of the photos for measuring, pixels
WINDOW = 9  # side of the square around a patch, pixels
ROUNDS = 10  # rounds of fitting; the medians converge in fewer
SHARP = 75.0  # photos at this percentile define sharp
FEWEST = 5  # patches needed to measure a photo
MOST = 20_000_000  # numbers of each measure; with more photos, fewer places are used
LEAST = 1e-8  # energy of values from 0 to 1
"""Added to energies; it is below the noise of 8 bits."""
DARKEST, BRIGHTEST = 8 / 255, 254 / 255
"""Range of values for exposures. Below, half a level of 8 bits is more than a tenth of a stop."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoQuality:
    """Measures of V photos at a box; NaN for photos that show too little of it or are unreadable.

    Attributes:
        sharpness: (V,) resolution relative to sharp photos, 0 to 1.
        overall: (V,) the same for the rest of the photo, from the scene's points elsewhere.
        exposure: (V,) of the whole photo, in stops (EV) above the median for the same places.
        texture: (P,) log energy of each patch's detail at the usual distance; NaN if not seen, or
            left out because there are many photos.
        unreadable: names of photos that cannot be read.
    """

    sharpness: Float64
    overall: Float64
    exposure: Float64
    texture: Float64
    unreadable: tuple[str, ...]


def measured(
    images: Sequence[PosedImage],
    patches: Patches,
    seen: NDArray[np.bool_],
    others: Float64,
    context: Context = QUIET,
) -> PhotoQuality:
    """Measure photos at the patches (P, V) that they see, and at points elsewhere (N, 3)."""
    places = np.concatenate([patches.places, others])
    step = -(-len(places) * len(images) // MOST) or 1
    places, seen = places[::step], seen[::step]
    energy = np.full((len(places), len(images)), np.nan)
    light, density = energy.copy(), energy.copy()
    small = [_small(image) for image in images]
    columns = {image.name: column for column, image in enumerate(small)}
    memory = max((_bytes(image) for image in small), default=1)
    failed = []
    with in_parallel(lambda image: _look(image, places), small, memory, context) as found:
        for image, job in found:
            column = columns[image.name]
            try:
                energy[:, column], light[:, column], density[:, column] = job.result()
            except PhotoError:
                failed.append(image.name)
    energy[: len(seen)][~seen] = np.nan
    light[: len(seen)][~seen] = np.nan
    with np.errstate(all="ignore"):
        detail, brightness = np.log(energy + LEAST), np.log2(light)
        rho = np.log(density)
    here, elsewhere = slice(len(seen)), slice(len(seen), None)
    texture = np.full(len(patches), np.nan)
    texture[::step], sharp = _effects(detail[here], rho[here])
    _, over = _effects(detail[elsewhere], rho[elsewhere])
    _, exposure = _effects(brightness, None)  # for whole photos: some may not see the box
    return PhotoQuality(
        sharpness=_resolution(sharp),
        overall=_resolution(over),
        exposure=exposure,
        texture=texture,
        unreadable=tuple(failed),
    )


def _small(image: PosedImage) -> PosedImage:
    return replace(image, camera=image.camera.thumbnail(SIDE))


def _bytes(image: PosedImage) -> int:
    size = image.camera.width, image.camera.height
    return decoding_bytes(image.path, size) + 40 * size[0] * size[1]


def _look(image: PosedImage, places: Float64) -> tuple[Float64, Float64, Float64]:
    """For places (P, 3): energy of the Laplacian, light, pixels per unit; NaN if not in view."""
    from scipy.ndimage import laplace, uniform_filter

    pixels = load_photo(image).astype(np.float32) / 255
    grey = pixels @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    at, depth, inside = photo_places(image, places)
    counted = load_mask(image)
    if counted is not None:
        flat = project(places, image.camera, image.world_to_camera)[0][inside].astype(int)
        inside[inside] = counted[flat[:, 1], flat[:, 0]]
    rows = np.flatnonzero(inside)
    x, y = at[rows].astype(int).T
    found = np.full((3, len(places)), np.nan)
    bright = uniform_filter(grey, WINDOW)[y, x].astype(np.float64)
    found[0, rows] = uniform_filter(laplace(grey) ** 2, WINDOW)[y, x] / (bright**2 + LEAST)
    tells = (bright >= DARKEST) & (bright <= BRIGHTEST)
    found[1, rows] = np.where(tells, srgb_curve(bright), np.nan)
    found[2, rows] = np.sqrt(image.camera.fx * image.camera.fy) / depth[rows]
    return found[0], found[1], found[2]


def _effects(values: Float64, slope_of: Float64 | None) -> tuple[Float64, Float64]:
    """Fit effects of patches (P,) and photos (V,) to values (P, V) by medians; NaN: too few."""
    values = values.copy()
    counts = np.isfinite(values).sum(axis=0)
    values[:, counts < FEWEST] = np.nan
    of_photo = np.zeros(values.shape[1])
    of_patch = _medians(values, axis=1)
    for _ in range(ROUNDS):
        if slope_of is not None:
            residual = values - of_photo - of_patch[:, None]
            centred = (
                slope_of - _medians(np.where(np.isfinite(values), slope_of, np.nan), 1)[:, None]
            )
            values = values - _slope(centred, residual) * centred
        of_photo = np.nan_to_num(_medians(values - of_patch[:, None], axis=0))
        of_patch = _medians(values - of_photo, axis=1)
    of_photo = (
        of_photo - np.median(of_photo[counts >= FEWEST]) if (counts >= FEWEST).any() else of_photo
    )
    return of_patch, np.where(counts >= FEWEST, of_photo, np.nan)


def _slope(x: Float64, y: Float64) -> float:
    """The slope of y over x, both (P, V), through 0: the median of y / x, weighted by |x|."""
    use = np.isfinite(x) & np.isfinite(y) & (np.abs(x) > 1e-3)
    if use.sum() < FEWEST:
        return 0.0
    ratios, weights = y[use] / x[use], np.abs(x[use])
    order = np.argsort(ratios)
    total = np.cumsum(weights[order])
    return float(ratios[order][np.searchsorted(total, total[-1] / 2)])


def _medians(values: Float64, axis: int) -> Float64:
    """Medians that ignore NaN; NaN if there are no numbers."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # for rows without numbers
        return np.asarray(np.nanmedian(values, axis=axis), dtype=np.float64)


def _resolution(effects: Float64) -> Float64:
    """(V,) effects on log energy -> resolution relative to sharp photos, at most 1."""
    good = effects[np.isfinite(effects)]
    if not len(good):
        return effects
    return np.asarray(np.exp(np.minimum(effects - np.percentile(good, SHARP), 0) / 4))
