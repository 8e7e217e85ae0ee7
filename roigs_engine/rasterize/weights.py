"""How much of views each Gaussian has: its blending weights alpha x T."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from ..context import QUIET, Context
from ..model.gaussians import Gaussians
from ..model.scene import Camera, Float64
from .limits import NO_LIMITS, Limits
from .view import rasterize_view

View = tuple[Camera, Float64]
"""A camera and its world_to_camera."""


class BlendingWeights(NamedTuple):
    """The weights of N Gaussians in a view's pixels.

    Attributes:
        largest: (N,) the largest one of each.
        total: (N,) their sum, each times its pixel's weight if pixels have weights.
    """

    largest: Tensor
    total: Tensor


@torch.no_grad()
def blending_weights(
    gaussians: Gaussians,
    views: Iterable[View],
    context: Context = QUIET,
    *,
    limits: Limits = NO_LIMITS,
    pixels: Iterable[Tensor | None] | None = None,
) -> Iterator[BlendingWeights]:
    """The weights in each view in turn, on the model's device.

    Args:
        gaussians: the model, N rows.
        views: to look from.
        context: checked for cancellation before each view.
        limits: which Gaussians are drawn; by default as in training.
        pixels: for each view, (H, W) weights of its pixels in the total; None: 1.

    Raises:
        Stopped: the user stopped.
    """
    every = iter(() if pixels is None else pixels)
    for camera, pose in views:
        counted = next(every, None)
        context.check_cancelled()
        output = rasterize_view(
            gaussians,
            camera,
            pose,
            sh_degree=0,  # colours do not matter
            limits=limits,
            with_max_weight=True,
            with_weight_sum=True,
            pixel_weights=None if counted is None else counted.to(gaussians.means)[None],
        )
        assert output.max_weight is not None and output.weight_sum is not None
        yield BlendingWeights(output.max_weight, output.weight_sum)
