"""Where Gaussians are left out of a picture, as the EWA approximation fails for them (ours)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import EngineError

MAX_SLOPE = 3.0
MIN_SIGMAS = 2.0


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Which Gaussians are drawn.

    Attributes:
        max_slope: none whose centre is beside the image and has a larger |x / z| (camera frame), or
            above or below it and has a larger |y / z|.
        min_sigmas: none that reaches behind the camera: whose depth is not more than so many of its
            standard deviations along the camera's z axis.

    Raises:
        EngineError: one is negative or NaN.
    """

    max_slope: float = math.inf
    min_sigmas: float = 0.0

    def __post_init__(self) -> None:
        for name in ("max_slope", "min_sigmas"):
            if not getattr(self, name) >= 0:
                raise EngineError(f"rasterize: {name} {getattr(self, name)} is not 0 or more.")


NO_LIMITS = Limits()
"""Of training: what it does not draw costs no loss, and other viewers draw it."""

PICTURE_LIMITS = Limits(max_slope=MAX_SLOPE, min_sigmas=MIN_SIGMAS)
"""Of every picture that is shown or measured."""
