"""Figures on the photos of a box, for people."""

from __future__ import annotations

import numpy as np

from ..model.scene import Float64, Int64
from .box_map import BoxMap
from .photo_quality import PhotoQuality

SIDES = ("-x", "+x", "-y", "+y", "-z", "+z")
"""The sides of a box, named by the box's axis along their normal."""


def pixel_lengths(found: BoxMap) -> Float64:
    """(P,) length of a pixel on each patch in the photo that shows it best; infinite if none."""
    centres = np.array([image.centre for image in found.images]).reshape(-1, 3)
    ways = centres[None] - found.patches.places[:, None]
    ways /= np.maximum(np.linalg.norm(ways, axis=2), 1e-300)[..., None]
    cosine = np.einsum("pvi,pi->pv", ways, found.patches.normals).clip(0, 1)
    # The geometric mean of the pixel's two sides on the tilted patch.
    density = found.density * found.sharpness * np.sqrt(cosine)
    best = density.max(axis=1, initial=0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(1 / best)


def pixels_across(found: BoxMap) -> float:
    """Pixels along the box's longest side, at the median of `pixel_lengths`; 0 if none is seen."""
    lengths = pixel_lengths(found)
    shown = lengths[np.isfinite(lengths)]
    return float(2 * found.roi.half_extents.max() / np.median(shown)) if len(shown) else 0.0


def exposure_spread(quality: PhotoQuality | None) -> float:
    """Stops between the darkest and the brightest photo; 0 if the photos were not measured."""
    known = [] if quality is None else quality.exposure[np.isfinite(quality.exposure)]
    return float(np.ptp(known)) if len(known) else 0.0


def sides_without_photos(found: BoxMap) -> list[str]:
    """The `SIDES` that cameras can see, but no photo does.

    A photo sees the side whose normal is nearest to the direction from the box's centre to it.
    """
    axes = found.roi.world_to_box[:3, :3]
    eyes = np.array([image.centre for image in found.images]).reshape(-1, 3) - found.roi.centre
    looked, free = found.directions[found.weights.sum(axis=0) > 0], np.zeros(len(SIDES), bool)
    free[_sides(looked @ axes.T)] = True
    free[_sides(eyes @ axes.T)] = False
    return [side for side, empty in zip(SIDES, free, strict=True) if empty]


def _sides(ways: Float64) -> Int64:
    """(N, 3) directions in the box's frame -> (N,) index in `SIDES`."""
    axis = np.abs(ways).argmax(axis=1)
    return np.asarray(2 * axis + (ways[np.arange(len(ways)), axis] > 0), dtype=np.int64)
