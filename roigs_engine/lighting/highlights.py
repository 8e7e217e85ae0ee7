"""How bright the lamps and windows are that photos show as white: their highlights are clipped."""

from __future__ import annotations

import numpy as np

from .panorama import Panorama, solid_angles

ALBEDO = 0.5  # share of the light that surfaces of a usual place give back
MOST = 100.0  # times brighter than white, at most, unless a person says so
FEWEST = 1e-5  # share of the directions that is clipped, at least


def usual_factor(panorama: Panorama) -> float:
    """What makes the clipped part as bright as it usually is, times what photos show.

    What surfaces give back is `ALBEDO` of what comes to them. So of all light, all but that share
    comes from lamps, windows and the sky. 1 if nothing is clipped.
    """
    weights = np.broadcast_to(solid_angles(len(panorama.light)), panorama.clipped.shape)
    bright = panorama.light.mean(axis=-1)
    lamps = float((weights * bright)[panorama.clipped].sum())
    surfaces = float((weights * bright)[~panorama.clipped].sum())
    if weights[panorama.clipped].sum() < FEWEST * 4 * np.pi or not lamps > 0:
        return 1.0
    return float(np.clip(surfaces * (1 / ALBEDO - 1) / lamps, 1.0, MOST))
