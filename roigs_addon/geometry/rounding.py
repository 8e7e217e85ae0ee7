"""Warns of rounded positions in Blender, which uses 32-bit numbers. Numpy only, no bpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

COARSE = 1e-4
"""Steps of positions above which rounding is visible, as a share of the model's width.

A position may be off by half a step. In a photo 4,000 pixels wide that shows the whole model, this
is a fifth of a pixel.
"""

ENOUGH = 100_000
"""Positions sampled for the bounds."""


def rounding(points: NDArray[np.float32] | NDArray[np.float64]) -> str:
    """Describe Blender's rounding of positions (N, 3) far from the origin; empty if invisible.

    A 32-bit number has 24 binary digits, so at a distance d, steps are up to d / 2^23: half a metre
    in map coordinates of 5,000 km.
    """
    if len(points) < 2:
        return ""
    some = points[:: -(-len(points) // ENOUGH)].astype(np.float64)
    low, high = np.percentile(some, (1, 99), axis=0)
    width, distance = float((high - low).max()), float(np.abs([low, high]).max())
    step = float(np.spacing(np.float32(distance))) if distance else 0.0
    if not step > COARSE * width:  # nor if they are NaN
        return ""
    return (
        f"lies {distance:,.0f} units from the origin and is {width:.3g} wide; there, Blender rounds"
        f" positions to steps of {step:.1g}"
    )
