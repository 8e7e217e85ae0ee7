"""Exposures of photos from EXIF; levels photos to one exposure in linear light.

With automatic exposure, a camera collects stops more light in dark views. Without the exposures, a
model learns these differences as view dependence, or as a mean of photos that disagree. With them,
each photo is decoded as if it had the median exposure.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .profiles import srgb_curve, srgb_values

LEAST_SPREAD = 0.1  # stops; if exposures differ by less, photos are not changed
CLIPPED = 235  # of 255: above this, tone curves compress or clip values
MOST = 255
EXIF_IFD, TIME, APERTURE, ISO = 0x8769, 0x829A, 0x829D, 0x8827  # EXIF 3.0, 4.6.5
BASE_ISO = 100
MOST_STOPS = 40  # limit for any camera, from night to sunlight
Key = TypeVar("Key")


def exif_exposure(path: Path) -> float | None:
    """log2(time x ISO / 100 / aperture^2), in stops: larger is brighter; None: not in EXIF.

    A photo without an aperture (from phones with a fixed one) counts as taken at f/1.
    """
    from .headers import PhotoError, exif_of, open_photo

    try:
        with open_photo(path) as photo:
            tags = exif_of(photo).get_ifd(EXIF_IFD)
    except (PhotoError, MemoryError):
        return None
    time, iso, aperture = (_number(tags.get(tag)) for tag in (TIME, ISO, APERTURE))
    if time is None or iso is None:
        return None
    # A sum of logarithms: with wrong numbers, a product could overflow or underflow.
    light = math.log2(time) + math.log2(iso) - math.log2(BASE_ISO)
    stops = light - 2 * math.log2(aperture or 1.0)
    return round(stops, 4) if abs(stops) <= MOST_STOPS else None


def _number(value: Any) -> float | None:
    """A positive number of EXIF; None if there is none. ISO may be several numbers."""
    try:
        number = float(value[0] if isinstance(value, tuple) else value)
    except (TypeError, ValueError, IndexError, ZeroDivisionError):
        return None
    return number if 0 < number < math.inf else None


def relative_exposures(exposures: Mapping[Key, float | None]) -> dict[Key, float]:
    """Stops by which photos are brighter than the median one; empty: they need no levelling.

    It is empty if EXIF has the exposure of less than half of them, or if they hardly differ. Photos
    without an exposure are missing from it.
    """
    known = {key: value for key, value in exposures.items() if value is not None}
    if 2 * len(known) < len(exposures) or not known:
        return {}
    values = np.array(list(known.values()))
    if np.ptp(values) < LEAST_SPREAD:
        return {}
    middle = float(np.median(values))
    return {key: round(value - middle, 4) for key, value in known.items()}


def levelled(pixels: NDArray[np.uint8], stops: float) -> NDArray[np.uint8]:
    """Reduce the light of sRGB pixels (..., 3) uint8 by `stops`; at most `white(stops)`."""
    return np.asarray(_table(stops)[pixels]) if stops else pixels


def exposed(values: NDArray[np.floating[Any]], stops: float) -> NDArray[np.floating[Any]]:
    """sRGB values in [0, 1] as a photo of `stops` more light shows them."""
    return srgb_values((srgb_curve(values) * 2.0**stops).clip(0, 1)) if stops else values


def white(stops: float) -> int:
    """The largest value, of 255, in a levelled photo; pixels with it may be brighter in reality.

    255 if the photo is no brighter than the median one.
    """
    return int(_table(max(stops, 0.0))[MOST])


@functools.lru_cache(maxsize=1024)  # training asks at each step
def _table(stops: float) -> NDArray[np.uint8]:
    """(256,) the new value for each value."""
    values = np.arange(MOST + 1).clip(max=CLIPPED if stops > 0 else MOST)
    return np.asarray((MOST * exposed(values / MOST, -stops)).round().astype(np.uint8))
