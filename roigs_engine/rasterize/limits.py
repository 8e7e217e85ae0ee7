"""Where Gaussians are left out of a picture, as the EWA approximation fails for them (ours).

Every backend asks here, so the kernels hold no number of their own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..errors import EngineError
from ..model.rotations import rotation_matrices

if TYPE_CHECKING:
    from .inputs import RenderInputs

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


def centre_bounds(inputs: RenderInputs, camera: int) -> tuple[float, float, float, float]:
    """Left, top, right, bottom, px: Gaussians with a centre not inside are culled.

    They follow from the camera and the whole image, also where only a part of it is active.
    """
    slope = inputs.limits.max_slope
    if slope == math.inf:  # the intrinsics wait for the GPU: not in training
        return -math.inf, -math.inf, math.inf, math.inf
    (fx, _, cx), (_, fy, cy), _ = inputs.Ks[camera].tolist()
    x, y = slope * fx, slope * fy
    return min(0, cx - x), min(0, cy - y), max(inputs.width, cx + x), max(inputs.height, cy + y)


@torch.no_grad()
def within(inputs: RenderInputs, camera: int, means2d: Tensor) -> Tensor:
    """(..., N) bool: which Gaussians, whose projected centres are (..., N, 2), the limits keep."""
    left, top, right, bottom = centre_bounds(inputs, camera)
    x, y = means2d.unbind(-1)
    inside = (x > left) & (x < right) & (y > top) & (y < bottom)
    means, quats, scales, _, _ = inputs.parameters
    axis = inputs.viewmats[camera, 2].to(means)
    axes = rotation_matrices(quats / quats.norm(dim=-1, keepdim=True))
    sigma = (axis[:3] @ axes * (scales.exp() if inputs.raw else scales)).norm(dim=-1)
    kept: Tensor = inside & (means @ axis[:3] + axis[3] > inputs.limits.min_sigmas * sigma)
    return kept
