"""Limits of rendering: which Gaussians are culled, and where blending ends."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ..errors import EngineError

MAX_SLOPE = 3.0
MIN_SIGMAS = 2.0


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits for the drawn Gaussians; EngineError if a number is negative or NaN.

    Attributes:
        max_slope: a Gaussian is culled if its centre is beside the image with a larger |x / z|
            (camera frame), or above or below it with a larger |y / z|.
        min_sigmas: a Gaussian is culled if it reaches behind the camera: if its depth is at most
            this many of its standard deviations along the camera's z axis.
        min_transmittance: pixels that let less light through need not draw Gaussians farther back,
            which changes a colour by at most this value. The cpu backend continues as long as a
            pixel of the same block lets more through; reference always continues. A Gaussian also
            gets no gradient from pixels (cpu: from blocks of pixels) in which its weight alpha x T
            is not larger; with reference, it does. The gradients of other Gaussians do not change.
    """

    max_slope: float = math.inf
    min_sigmas: float = 0.0
    min_transmittance: float = 1e-6

    def __post_init__(self) -> None:
        for name in ("max_slope", "min_sigmas", "min_transmittance"):
            if not getattr(self, name) >= 0:
                raise EngineError(f"rasterize: {name} {getattr(self, name)} is not 0 or more.")


NO_LIMITS = Limits()

PICTURE_LIMITS = Limits(max_slope=MAX_SLOPE, min_sigmas=MIN_SIGMAS)
"""Limits of every picture that is shown or measured."""

TRAINING_LIMITS = Limits(min_transmittance=1e-3)
"""Of half of the training steps, with `PICTURE_LIMITS` in the others (`training_limits`). A
thousandth of the light is a quarter of what 8 bits can tell apart (notebook/cpu_speed.md)."""

GOLDEN = (math.sqrt(5) - 1) / 2  # its multiples share no period with masks or photos


def training_limits(step: int, *, linear_light: bool) -> Limits:
    """Return the limits of a training step (ours): in half of the steps, evenly spread, pictures'.

    Training without limits hides light in large Gaussians around the cameras, which pictures do
    not draw. Training only with limits leaves fog that costs no loss, and other viewers draw it
    (docs/method.md, "Where Gaussians are not drawn").
    """
    limits = TRAINING_LIMITS
    if linear_light:  # 12.92: slope of the sRGB curve at black, its steepest place
        limits = replace(limits, min_transmittance=limits.min_transmittance / 12.92)
    if step * GOLDEN % 1 < 0.5:
        limits = replace(PICTURE_LIMITS, min_transmittance=limits.min_transmittance)
    return limits
