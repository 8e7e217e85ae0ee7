"""Renders a model from one camera: pictures, and the blending weights of its Gaussians."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
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

LEAST_PIXEL = 1 / 16
"""Least side of a pixel, in pixels of a photo: for smaller pixels, blur would only take time."""
SAME_FOCAL = 0.05
"""Focal lengths that differ by at most this share count as equal: focusing changes them as much."""
PARALLEL = 100.0
"""Focal length in widths of the picture above which its rays count as parallel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderedView:
    """A rendered image, and its depth if that was requested."""

    image: Tensor  # (H, W, 3) float32 sRGB values in [0, 1]
    depth: Tensor | None  # (H, W) mean along z, world units; 0 without a Gaussian


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

    `PICTURE_LIMITS` apply, as in every picture that is shown or measured.
    """
    width, height = camera.width, camera.height
    with explain_out_of_memory(
        lambda: f"rendering {len(gaussians):,} Gaussians at {width}x{height}",
        f"Render smaller images (--max-side {smaller_side(width, height)}), or use --device cpu.",
    ):
        output = rasterize_view(
            gaussians,
            camera,
            world_to_camera,
            limits=PICTURE_LIMITS,
            background=background,
            with_depth=with_depth,
        )
    depth = None if output.depth is None else output.depth[0]
    return RenderedView(image=output.image[0].clamp(0, 1), depth=depth)


def pixel_size(gaussians: Gaussians, camera: Camera) -> float:
    """Return the side of the camera's pixels, in pixels of the model's training photos (ours).

    A model has learned to look right with its photos' blur, which is an angle. In a picture with
    other pixels, the same blur in pixels would be too wide or too narrow (docs/method.md, "Other
    sizes than the photos'"). The result is 1 if the photos are unknown, or the rays are parallel:
    then pixels have no angle. It is also 1 for the photos' own focal length, which may vary a
    little.
    """
    if gaussians.photo_focal is None or camera.focal > PARALLEL * camera.width:
        return 1.0
    size = gaussians.photo_focal / camera.focal
    return 1.0 if abs(size - 1) <= SAME_FOCAL else max(size, LEAST_PIXEL)


def rasterize_view(
    gaussians: Gaussians, camera: Camera, world_to_camera: Float64, **options: Any
) -> RenderOutput:
    """`rasterize` a model from one camera, with its target's options, on its device."""
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
        pixel_size=pixel_size(gaussians, camera),
        **gaussians.target.drawing,
        **options,
    )


View = tuple[Camera, Float64]
"""A camera and its world_to_camera."""


class BlendingWeights(NamedTuple):
    """The weights of N Gaussians in a view's pixels."""

    largest: Tensor  # (N,) largest weight of each Gaussian
    total: Tensor  # (N,) sum of its weights, each times its pixel's weight if pixels have weights


@torch.no_grad()
def blending_weights(
    gaussians: Gaussians,
    views: Iterable[View],
    context: Context = QUIET,
    *,
    limits: Limits = NO_LIMITS,
    pixels: Iterable[Tensor | None] | None = None,
) -> Iterator[BlendingWeights]:
    """Yield the weights in each view, on the model's device; check for a stop before each.

    `pixels` are (H, W) weights of each view's pixels in the total; None for 1. The blur is the
    target's, for any size of pixels.
    """
    gaussians = replace(gaussians, photo_focal=None)
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
