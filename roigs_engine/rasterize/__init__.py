"""Rendering of 3D Gaussians and its gradient (3D Gaussian Splatting, Kerbl et al. 2023).

`rasterize` is the only entry point. Three backends compute the same function:

    reference   plain torch, float32 or float64, any device: readable, and the tests' reference
    cpu         the compiled kernels: float32 tensors on the CPU
    cuda        gsplat's kernels: float32 tensors on an NVIDIA GPU
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..errors import EngineError
from .inputs import (
    BackwardStep,
    RenderInputs,
    RenderOutput,
    background_colour,
    check_backward_step,
    check_inputs,
    check_pixel_weights,
    used_sh_degree,
)
from .tiles import active_tiles

__all__ = ["RenderOutput", "rasterize"]

BACKENDS = ("auto", "cpu", "cuda", "reference")


def rasterize(
    means: Tensor,  # (N, 3) centres, world frame
    quats: Tensor,  # (N, 4) rotations wxyz, normalised inside
    scales: Tensor,  # (N, 3) standard deviations along the Gaussian's own axes, or their logs
    opacities: Tensor,  # (N,) in (0, 1), or logits
    sh: Tensor,  # (N, K, 3) spherical harmonics, K = 1, 4, 9 or 16
    viewmats: Tensor,  # (C, 4, 4) world_to_camera, OpenCV axes
    Ks: Tensor,  # (C, 3, 3) pinhole intrinsics in pixels
    width: int,
    height: int,
    *,
    sh_degree: int | None = None,
    raw: bool = False,
    background: Tensor | None = None,  # (3,)
    with_depth: bool = False,
    with_max_weight: bool = False,
    with_weight_sum: bool = False,
    pixel_weights: Tensor | None = None,  # (C, H, W)
    mask: tuple[int, int, int, int] | Tensor | None = None,
    backward_step: BackwardStep | None = None,
    backend: str = "auto",
) -> RenderOutput:
    """Render N Gaussians for C cameras; `image` is differentiable in the first five arguments.

    Each Gaussian is projected with the EWA approximation (3DGS, section 4; Zwicker et al. 2001),
    coloured by its spherical harmonics (SH), max(SH(direction) + 0.5, 0), and blended front to back
    by the camera depth of its centre (3DGS, eq. 3). Pixel centres lie at +0.5. The constants of the
    model (near plane, blur, opacity bounds) are in `rasterize.inputs`.

    A Gaussian with NaN or Inf is culled; its gradient is zero.

    Args:
        sh_degree: bands above it are ignored and get no gradient; None: all bands in `sh`.
        raw: `scales` are natural logarithms and `opacities` logits, the form that is stored and
            trained; gradients are with respect to these.
        background: colour behind everything; None: black.
        with_depth: also return the mean depth.
        with_max_weight: also return each Gaussian's largest blending weight.
        with_weight_sum: also return the sum over pixels of each Gaussian's blending weights. No
            caller today; levels of detail and masks will use it.
        pixel_weights: weight of each pixel in `weight_sum`, for example 1 inside a mask and 0
            outside; None: 1. No caller today; levels of detail and masks will use it.
        mask: x0, y0, x1, y1 in pixels, end exclusive, or a bool mask (H, W). Only the 16x16 tiles
            that touch it are active, forward and backward; other pixels get the background.
        backward_step: an optimizer step on the first five arguments. `backward()` takes the step
            for the visible Gaussians instead of returning gradients, and can be called once. One
            camera, cpu backend.
        backend: "reference", "cpu", "cuda", or "auto": for float32 the compiled backend of the
            tensors' device, else the reference.

    Gradients: if an input is a leaf with an allocated `.grad`, the cpu backend adds to that buffer
    and touches only the rows of visible Gaussians. So the cost of a training step does not depend
    on the invisible Gaussians. Otherwise inputs get dense gradients, as in any torch function.
    Cameras and background get none.

    Raises:
        EngineError: the arguments do not fit together.
        KernelError: there are too many pairs of Gaussians and tiles for the kernels or the memory,
            or the backend cannot be used.
    """
    parameters = (means, quats, scales, opacities, sh)
    check_inputs(parameters, viewmats, Ks, width, height)
    if pixel_weights is not None:
        check_pixel_weights(pixel_weights, with_weight_sum, (len(viewmats), height, width))
        pixel_weights = pixel_weights.detach().to(means)
    if backend == "auto":
        native = all(p.dtype == torch.float32 for p in parameters)
        compiled = native and means.device.type in ("cpu", "cuda")
        backend = means.device.type if compiled else "reference"
    if backward_step is not None:
        check_backward_step(backward_step, parameters, len(viewmats), backend)
    tiles, tile_mask = active_tiles(width, height, mask)
    inputs = RenderInputs(
        means=means,
        quats=quats,
        scales=scales,
        opacities=opacities,
        sh=sh,
        viewmats=viewmats,
        Ks=Ks,
        width=int(width),
        height=int(height),
        sh_degree=used_sh_degree(sh.shape[1], sh_degree),
        raw=raw,
        background=background_colour(background, means),
        with_depth=with_depth,
        with_max_weight=with_max_weight,
        with_weight_sum=with_weight_sum,
        pixel_weights=pixel_weights,
        tiles=tiles,
        tile_mask=None if tile_mask is None else tile_mask.to(means.device),
        backward_step=backward_step,
    )
    if backend == "reference":
        from . import reference

        return reference.render(inputs)
    if backend == "cpu":
        from . import cpu

        return cpu.render(inputs)
    if backend == "cuda":
        from . import cuda

        return cuda.render(inputs)
    raise EngineError(f"rasterize: unknown backend {backend!r}.", f"Use one of {BACKENDS}.")
