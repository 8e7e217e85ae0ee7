"""Views of a model from one camera: pictures, and the blending weights of its Gaussians."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..cuda.device import explain_out_of_memory, smaller_side
from ..model.gaussians import Gaussians
from ..model.scene import Camera, Float64
from . import RenderOutput, rasterize
from .limits import NO_LIMITS, PICTURE_LIMITS, Limits


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderedView:
    """A rendered image.

    Attributes:
        image: (H, W, 3) float32 sRGB values in [0, 1].
        depth: (H, W) expected depth along the camera's z axis, world units, 0 where no Gaussian
            is; None unless requested.
    """

    image: Tensor
    depth: Tensor | None


@torch.no_grad()
def render_view(
    gaussians: Gaussians,
    camera: Camera,
    world_to_camera: Float64,  # (4, 4)
    *,
    with_depth: bool = False,
    background: Tensor | None = None,  # (3,)
) -> RenderedView:
    """Render the model from one camera, on the model's device, without gradients.

    `PICTURE_LIMITS` hold, as in everything that is shown or measured.
    """
    size = camera.width, camera.height

    def doing() -> str:
        return f"rendering {len(gaussians):,} Gaussians at {size[0]}x{size[1]}"

    def advice() -> str:
        return f"Render smaller images (--max-side {smaller_side(*size)}), or use --device cpu."

    with explain_out_of_memory(doing, advice):
        output = rasterize_view(
            gaussians,
            camera,
            world_to_camera,
            limits=PICTURE_LIMITS,
            background=background,
            with_depth=with_depth,
        )
    depth = output.depth[0] if with_depth and output.depth is not None else None
    return RenderedView(image=output.image[0].clamp(0, 1), depth=depth)


def rasterize_view(
    gaussians: Gaussians, camera: Camera, world_to_camera: Float64, **options: Any
) -> RenderOutput:
    """`rasterize` a model from one camera, on its device; as in training by default.

    Args:
        gaussians: the model.
        camera: the camera.
        world_to_camera: (4, 4).
        options: of `rasterize`.
    """
    device = gaussians.means.device
    viewmat = torch.as_tensor(np.asarray(world_to_camera), dtype=torch.float32, device=device)
    matrix = torch.as_tensor(camera.matrix(), dtype=torch.float32, device=device)
    return rasterize(
        gaussians.means,
        gaussians.quats,
        gaussians.log_scales,
        gaussians.logit_opacities,
        gaussians.sh,
        viewmat[None],
        matrix[None],
        camera.width,
        camera.height,
        raw=True,
        antialiased=gaussians.antialiased,
        **options,
    )


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
