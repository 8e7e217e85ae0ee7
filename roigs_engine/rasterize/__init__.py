"""Renders 3D Gaussians, and computes the gradient (3D Gaussian Splatting, Kerbl et al. 2023).

`rasterize` is the only entry point. Four backends compute the same function:

    reference   plain torch, float32 or float64, any device: readable, and the tests' reference
    cpu         the compiled kernels: float32 tensors on the CPU
    cuda        our CUDA kernels: float32 tensors on an NVIDIA GPU
    gpu         compute shaders on any GPU: float32 tensors on the CPU

Each Gaussian is projected with the EWA approximation (3DGS, section 4; Zwicker et al. 2001). Its
colour comes from spherical harmonics (SH), max(SH(direction) + 0.5, 0). Gaussians are blended front
to back by the camera depth of their centres (3DGS, eq. 3), as sRGB values, or with `linear_light`
as light. Pixel centres lie at +0.5. The constants of the model (near plane, opacity bounds) are in
`rasterize.inputs`. A Gaussian with NaN or Inf is culled; its gradient is zero.

With `limits`, a Gaussian is culled if it lies far beside the image or reaches behind the camera.
There the EWA approximation fails: a needle just in front of the camera plane would cover the image
like fog. `view.render_view` uses such limits (`limits.PICTURE_LIMITS`), and so do half of the
training steps (`limits.training_limits`). In training, blending stops earlier where hardly any
light is left (`limits.TRAINING_LIMITS`).

A `mask` is x0, y0, x1, y1 in pixels, end exclusive, or bool (H, W). Only the 16x16 tiles that it
touches are active, forward and backward; other pixels get the background. `ActiveTiles` are faster,
and may have a window: images then contain only this part of the picture.

Cameras and background get no gradient. With a `backward_step`, the backward pass touches only the
rows of Gaussians that get a gradient from pixels. The cost of a training step does not depend on
the others.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..cuda.device import sent
from ..errors import EngineError, KernelError
from ..formats.targets import BLUR
from ..gpu.program import opened
from .inputs import (
    BackwardStep,
    Depth,
    RenderInputs,
    RenderOutput,
    background_colour,
    blur_of,
    check_backward_step,
    check_inputs,
    checked_depth,
    checked_pixel_weights,
    used_sh_degree,
)
from .limits import NO_LIMITS, Limits
from .tiles import Mask, active_tiles

__all__ = ["RenderOutput", "rasterize"]

BACKENDS = ("auto", "cpu", "cuda", "gpu", "reference")


def rasterize(
    means: Tensor,  # (N, 3) centres, world frame
    quats: Tensor,  # (N, 4) rotations wxyz, normalised inside
    scales: Tensor,  # (N, 3) standard deviations along the Gaussian's own axes
    opacities: Tensor,  # (N,) in (0, 1)
    sh: Tensor,  # (N, K, 3) spherical harmonics, K = 1, 4, 9 or 16
    viewmats: Tensor,  # (C, 4, 4) world_to_camera, OpenCV axes
    Ks: Tensor,  # (C, 3, 3) pinhole intrinsics in pixels
    width: int,
    height: int,
    *,
    sh_degree: int | None = None,  # bands above it are ignored, without gradient; None for no limit
    raw: bool = False,  # scales are natural logs and opacities logits, as in training
    limits: Limits = NO_LIMITS,  # which Gaussians are culled, and where blending ends
    background: Tensor | None = None,  # (3,) colour behind everything; None for black
    with_depth: Depth = False,  # also return the mean depth, or the "median"
    with_max_weight: bool = False,  # also return each Gaussian's largest blending weight
    with_weight_sum: bool = False,  # also return the sum of its weights
    with_surface: bool = False,  # also return depth and normals, with gradients; see `Surface`
    pixel_weights: Tensor | None = None,  # (C, H, W) factors in `weight_sum`; None for 1
    mask: Mask = None,
    linear_light: bool = False,  # colours are blended as light, as in Blender; not as sRGB values
    antialiased: bool = False,  # a Gaussian below a pixel's size is fainter, not larger
    blur: float = BLUR,  # added to the 2D covariance's diagonal, px^2 of the whole photo
    pixel_size: float = 1.0,  # side of a pixel, in pixels of the whole photo; acts like averaging
    backward_step: BackwardStep | None = None,  # of one camera, taken by `backward`, once
    backend: str = "auto",  # auto: the device's compiled one for float32, else the reference
) -> RenderOutput:
    """Render N Gaussians for C cameras; `image` is differentiable in the first five arguments.

    EngineError: wrong arguments. KernelError: the view is too large, or the backend is missing.
    """
    parameters = (means, quats, scales, opacities, sh)
    check_inputs(parameters, viewmats, Ks, width, height)
    backend = _chosen(backend, parameters)
    check_backward_step(backward_step, parameters, len(viewmats), backend)
    active, shape = active_tiles(width, height, mask), (len(viewmats), height, width)
    inputs = RenderInputs(
        parameters=parameters,
        viewmats=viewmats,
        Ks=Ks,
        width=int(width),
        height=int(height),
        sh_degree=used_sh_degree(sh.shape[1], sh_degree),
        raw=raw,
        linear_light=linear_light,
        limits=limits,
        background=background_colour(background, means, linear_light=linear_light),
        with_depth=checked_depth(with_depth),
        with_max_weight=with_max_weight,
        with_weight_sum=with_weight_sum,
        with_surface=with_surface,
        pixel_weights=checked_pixel_weights(pixel_weights, with_weight_sum, shape, means),
        window=active.shown,
        tiles=active.rectangle,
        tile_mask=None if active.mask is None else sent(active.mask, means.device),
        blur=blur_of(pixel_size, antialiased, blur),
        backward_step=backward_step,
    )
    return _rendered(backend, inputs).cut(active.shown).in_srgb(linear_light=linear_light)


def _chosen(backend: str, parameters: tuple[Tensor, ...]) -> str:
    """Return the backend to use; for "auto", the compiled one of the device if there is one."""
    if backend not in BACKENDS:
        raise EngineError(f"rasterize: unknown backend {backend!r}.", f"Use one of {BACKENDS}.")
    device, is_float = parameters[0].device.type, all(p.dtype == torch.float32 for p in parameters)
    if backend == "auto":
        if is_float and device == "cpu" and opened() is not None:
            return "gpu"
        return device if is_float and device in ("cpu", "cuda") else "reference"
    if (backend != "reference" and not is_float) or (backend in ("cpu", "gpu") and device != "cpu"):
        kinds = ", ".join(sorted({str(p.dtype) for p in parameters}))
        raise KernelError(
            f"rasterize: the {backend} backend does not take {kinds} on {device}.",
            "Pass float32 tensors on its device.",
        )
    return backend


def _rendered(backend: str, inputs: RenderInputs) -> RenderOutput:
    """Render with a backend, which is imported at its first use."""
    if backend != "gpu":
        inputs.settle()
    if backend == "cpu":
        from .cpu import render
    elif backend == "cuda":
        from .cuda import render
    elif backend == "gpu":
        from .gpu import render
    else:
        from .reference import render
    return render(inputs)
