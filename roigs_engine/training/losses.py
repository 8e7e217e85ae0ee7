"""The training loss of a render against its photo: L1 and SSIM, as in 3D Gaussian Splatting.

    L = (1 - w) L1 + w (1 - SSIM),  w = 0.2                (Kerbl et al. 2023, eq. 7)

Images are (H, W, 3) sRGB values in [0, 1], photos (H, W, 3) uint8. SSIM (Wang et al. 2004) has an
11 x 11 Gaussian window of sigma 1.5, zeros around the image, C1 = 0.01^2 and C2 = 0.03^2. A pixel
that a mask ignores is treated like one outside the image: zero in both pictures, and without weight
(docs/method.md, "Ignored pixels").
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..cuda import card
from ..cuda.bindings import PIXELS, Loss, address
from ..errors import EngineError
from ..kernels import bindings
from ..model.scene import PosedImage
from ..photos.exposures import MOST, white

BACKENDS = ("auto", "cpu", "cuda")
TILE = 16  # of the CUDA kernel


class LossOutput(NamedTuple):
    """The loss and its parts, each a scalar tensor; gradients flow through `loss` alone."""

    loss: Tensor
    l1: Tensor
    ssim: Tensor


def photo_loss(
    image: Tensor,  # (H, W, 3) or (1, H, W, 3)
    target: Tensor,  # (H, W, 3) uint8
    *,
    ssim_weight: float = 0.2,
    weights: Tensor | None = None,  # (H, W)
    counted: Tensor | None = None,  # (H, W) bool
    backend: str = "auto",
) -> LossOutput:
    """The training loss; differentiable in `image`.

    Args:
        image: float32 in [0, 1]. A permuted view of planar (3, H, W) memory is the fastest form:
            it is not copied, and its gradient has the same form.
        target: the photo, on the image's device.
        ssim_weight: weight of the SSIM term, 0 to 1.
        weights: weight of each pixel in both terms, not negative; None for equal weights. They are
            divided by their sum. The SSIM of a pixel still depends on all pixels around it. If all
            weights are zero, so is the loss.
        counted: the pixels that no mask ignores; None for all.
        backend: "cpu" (compiled kernel, tensors on the CPU), "cuda" (our kernel, on an NVIDIA
            GPU), or "auto" for that of the image's device.

    Raises:
        EngineError: wrong shapes or types, or an unknown backend.
    """
    # squeeze, not [0]: its gradient is a view, that of an index is a copy into zeros
    planes = image.squeeze(0) if image.dim() == 4 else image
    _check(planes, target, weights, counted)
    if counted is not None:
        planes, target, weights = _without_ignored(planes, target, weights, counted)
    backend = planes.device.type if backend == "auto" else backend
    if backend not in BACKENDS:
        raise EngineError(f"photo_loss: unknown backend {backend!r}.", f"Use one of {BACKENDS}.")
    if backend == "cpu" and planes.device.type != "cpu":
        raise EngineError("photo_loss: the cpu backend takes tensors on the CPU only.")
    terms = _terms_on_cpu if backend == "cpu" else _terms_on_gpu
    return LossOutput(*_KernelLoss.apply(planes, target, ssim_weight, weights, terms))  # type: ignore[no-untyped-call]


def clipped_like(image: Tensor, photo: PosedImage) -> Tensor:
    """Clip the image at the photo's white if levelling darkened it; no gradient above it."""
    largest = white(photo.exposure)
    return image if largest == MOST else image.clamp(max=largest / MOST)


def _without_ignored(
    image: Tensor, target: Tensor, weights: Tensor | None, counted: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Set image, photo and weights to zero at ignored pixels; NaN of the image is removed there."""
    shown = counted[..., None]
    zero = image.new_zeros(())
    weights = counted.to(torch.float32) if weights is None else weights * counted
    return torch.where(shown, image, zero), target * shown, weights


class _KernelLoss(torch.autograd.Function):
    """Value and gradient from one kernel, on the CPU or a GPU; does not wait for the GPU."""

    @staticmethod
    def forward(
        ctx: Any,
        image: Tensor,
        target: Tensor,
        ssim_weight: float,
        weights: Tensor | None,
        terms: Callable[..., Tensor],
    ) -> tuple[Tensor, Tensor, Tensor]:
        planar = image.permute(2, 0, 1).contiguous()  # no copy when it is planar already
        mask = None if weights is None else weights.to(torch.float32).contiguous()
        gradient = torch.empty_like(planar) if ctx.needs_input_grad[0] else None
        loss, l1, ssim = terms(planar, target.contiguous(), ssim_weight, mask, gradient).unbind()
        ctx.save_for_backward(gradient)
        ctx.on_cpu = terms is _terms_on_cpu
        ctx.mark_non_differentiable(l1, ssim)
        ctx.set_materialize_grads(False)
        return loss, l1, ssim

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor | None) -> tuple[Tensor | None, ...]:
        scale, (gradient,) = upstream[0], ctx.saved_tensors
        if scale is None or gradient is None:
            return (None,) * 5
        # The usual factor of 1 needs no pass over the image. Reading it would wait for a GPU.
        if not ctx.on_cpu or scale != 1:
            gradient.mul_(scale)  # in place: new memory costs more. torch refuses a second backward
        return gradient.permute(1, 2, 0), *(None,) * 4


def _terms_on_cpu(
    image: Tensor, photo: Tensor, ssim_weight: float, mask: Tensor | None, gradient: Tensor | None
) -> Tensor:
    """(3,) loss, L1 and SSIM from `roigs_photo_loss` of kernels/loss.cpp; fills the gradient."""
    _, height, width = image.shape
    tensors = (bindings.pointer(tensor) for tensor in (image, photo, mask))
    result = (ctypes.c_double * 3)()
    bindings.kernels().roigs_photo_loss(
        width, height, *tensors, ssim_weight, bindings.pointer(gradient), result
    )
    return torch.tensor(list(result), dtype=torch.float32)


def _terms_on_gpu(
    image: Tensor, photo: Tensor, ssim_weight: float, mask: Tensor | None, gradient: Tensor | None
) -> Tensor:
    """Compute what `_terms_on_cpu` does, with cuda/kernels/loss.cu."""
    _, height, width = image.shape
    blocks = 3 * -(-height // TILE) * -(-width // TILE)
    total = None if mask is None else mask.sum(dtype=torch.float64)
    sums, terms = image.new_empty(blocks, 2), image.new_empty(3)
    derivatives = None if gradient is None else image.new_empty(3, *image.shape)
    pointers = (address(t) for t in (image, photo, mask, total))
    results = (address(t) for t in (derivatives, sums, gradient, terms))
    loss = Loss(width, height, *pointers, ssim_weight, *results, blocks)
    program = card.program(image.device)
    program.launch("loss", blocks, PIXELS, loss)
    if gradient is not None:
        program.launch("loss_gradient", blocks, PIXELS, loss)
    program.launch("loss_terms", 1, PIXELS, loss)
    return terms


def _check(image: Tensor, target: Tensor, weights: Tensor | None, counted: Tensor | None) -> None:
    shape = tuple(image.shape)
    if image.dim() != 3 or shape[2] != 3 or 0 in shape or image.dtype != torch.float32:
        raise EngineError(f"photo_loss: image is {shape} {image.dtype}, not (H, W, 3) float32.")
    if tuple(target.shape) != shape or target.dtype != torch.uint8:
        raise EngineError(
            f"photo_loss: target is {tuple(target.shape)} {target.dtype}, not {shape} uint8."
        )
    if weights is not None and tuple(weights.shape) != shape[:2]:
        raise EngineError(f"photo_loss: weights are {tuple(weights.shape)}, not {shape[:2]}.")
    if counted is not None and (tuple(counted.shape) != shape[:2] or counted.dtype != torch.bool):
        raise EngineError(
            f"photo_loss: counted is {tuple(counted.shape)} {counted.dtype}, not {shape[:2]} bool."
        )
