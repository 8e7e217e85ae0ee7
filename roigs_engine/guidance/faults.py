"""Finds photos that are less useful than they should be, with the reason.

A photo is compared with the others at the same patches (`photo_quality`). Information grows with
the square of the resolution (`box_map`). So a photo with less than 1/sqrt(2) of the sharp photos'
resolution has less than half of the possible information. It is blurred or, if it is sharp
elsewhere, out of focus at the object. Exposures are reported if they differ by a stop (half or
twice the light) and are outliers. If many differ, they are levelled (`photos.exposures`). A camera
with few points may be misplaced (`formats.projects`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from ..formats.projects import weakly_observed
from ..formats.text import counted
from ..model.scene import Float64
from .known import KnownBox

HALF = 0.5
STOP = 1.0
FEW = 0.1  # share of the photos: if more differ, none is an outlier
OUTLIER = 3 * 1.4826  # median deviations; three standard deviations of a normal distribution

BLURRED, FOCUS, EXPOSED, PLACED, UNREADABLE = (
    "blurred",
    "out of focus",
    "exposure",
    "misplaced",
    "unreadable",
)


@dataclass(frozen=True, kw_only=True)
class PhotoFault:
    """A photo of a box that the user should check, and perhaps exclude.

    Attributes:
        photo: its name.
        reason: one of the constants of this module.
        text: the reason with a figure, for people.
    """

    photo: str
    reason: str
    text: str

    def to_dict(self) -> dict[str, str]:
        """The fault as JSON values."""
        return asdict(self)


def photo_faults(known: KnownBox) -> tuple[PhotoFault, ...]:
    """Find the faults of a box's photos, the worst first; a photo may have several.

    A fault is worse if it leaves less of the photo's information. Empty if the photos were not read
    (`known_box(look=False)`).
    """
    quality = known.quality
    if quality is None:
        return ()
    found = [
        (0.0, PhotoFault(photo=name, reason=UNREADABLE, text="unreadable"))
        for name in quality.unreadable
    ]
    points = {image.name: len(image.point_indices) for image in known.map.images}
    if any(points.values()):  # otherwise the model stores no tracks
        for name in weakly_observed(points):
            text = f"perhaps misplaced: its camera has only {counted(points[name], 'point')}"
            found.append((0.0, PhotoFault(photo=name, reason=PLACED, text=text)))
    odd = _odd_exposures(quality.exposure)
    for column, image in enumerate(known.map.images):
        sharp, overall = quality.sharpness[column], quality.overall[column]
        if sharp**2 < HALF:
            of = f"{sharp:.0%} of the sharp photos' resolution"
            if overall**2 < HALF:
                fault = PhotoFault(photo=image.name, reason=BLURRED, text=f"blurred: {of}")
            else:
                text = f"out of focus at the object: {of}"
                fault = PhotoFault(photo=image.name, reason=FOCUS, text=text)
            found.append((float(sharp) ** 2, fault))
        exposure = float(quality.exposure[column])
        if odd[column]:
            way = "brighter" if exposure > 0 else "darker"
            text = f"{abs(exposure):.1f} stops {way} than the others"
            fault = PhotoFault(photo=image.name, reason=EXPOSED, text=text)
            found.append((2.0 ** -abs(exposure), fault))
    return tuple(fault for _, fault in sorted(found, key=lambda pair: (pair[0], pair[1].photo)))


def _odd_exposures(exposures: Float64) -> NDArray[np.bool_]:
    """(V,) which photos are outliers; `exposures` have a median of 0, NaN: unknown."""
    away = np.abs(exposures)
    known = away[np.isfinite(away)]
    spread = float(np.median(known)) if len(known) else 0.0
    odd = away >= max(STOP, OUTLIER * spread)
    return np.asarray(odd if odd.mean() <= FEW else np.zeros_like(odd))
