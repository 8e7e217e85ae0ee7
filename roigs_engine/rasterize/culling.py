"""Which Gaussians the limits of a picture keep; for all backends, the kernels hold no number."""

from __future__ import annotations

import math

from torch import Tensor

from ..model.rotations import rotation_matrices
from .inputs import RenderInputs


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


def within(inputs: RenderInputs, camera: int, means2d: Tensor) -> Tensor:
    """(..., N) bool: which Gaussians, whose projected centres are (..., N, 2), the limits keep.

    Call it without gradients.
    """
    left, top, right, bottom = centre_bounds(inputs, camera)
    x, y = means2d.unbind(-1)
    inside = (x > left) & (x < right) & (y > top) & (y < bottom)
    means, quats, scales, _, _ = inputs.parameters
    axis = inputs.viewmats[camera, 2].to(means)
    axes = rotation_matrices(quats / quats.norm(dim=-1, keepdim=True))
    sigma = (axis[:3] @ axes * (scales.exp() if inputs.raw else scales)).norm(dim=-1)
    kept: Tensor = inside & (means @ axis[:3] + axis[3] > inputs.limits.min_sigmas * sigma)
    return kept
