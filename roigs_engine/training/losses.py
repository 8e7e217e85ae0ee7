"""The training loss of a render against its photo: L1 and SSIM, as in 3D Gaussian Splatting.

    L = (1 - w) L1 + w (1 - SSIM),  w = 0.2                (Kerbl et al. 2023, eq. 7)

Images are (H, W, 3) sRGB values in [0, 1], photos (H, W, 3) uint8. SSIM (Wang et al. 2004) has an
11 x 11 Gaussian window of sigma 1.5, zeros around the image, C1 = 0.01^2 and C2 = 0.03^2.

A pixel that a mask ignores is as one beyond the image: zero in both pictures, and without weight.
So neither term depends on what render or photo show there, also through the windows of pixels
nearby, and its gradient is exactly zero. To fill the hole with the render instead would let the
render's own values there decide how much SSIM sees of a difference nearby.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from ..cuda import card
from ..cuda.bindings import PIXELS, Loss, address
from ..errors import EngineError
from ..kernels import bindings

WINDOW_RADIUS = 5
WINDOW_SIGMA = 1.5
C1 = 0.01**2
C2 = 0.03**2
BACKENDS = ("auto", "cpu", "cuda", "reference")
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
        image: values in [0, 1]. A permuted view of planar (3, H, W) memory is the fastest form:
            it is not copied, and its gradient has the same form.
        target: the photo, on the image's device.
        ssim_weight: weight of the SSIM term, 0 to 1.
        weights: weight of each pixel in both terms, not negative; None: all equal. They are
            divided by their sum. The SSIM of a pixel still depends on all pixels around it. If all
            weights are zero, so is the loss.
        counted: the pixels that no mask ignores; None: all.
        backend: "cpu" (compiled kernel: float32 on the CPU), "cuda" (our kernel: float32 on an
            NVIDIA GPU), "reference" (plain torch, any dtype and device), or "auto": the first
            one that supports the arguments.

    Raises:
        EngineError: wrong shapes or types, or an unknown backend.
    """
    # squeeze, not [0]: its gradient is a view, that of an index is a copy into zeros
    planes = image.squeeze(0) if image.dim() == 4 else image
    _check(planes, target, weights, counted)
    if counted is not None:
        planes, target, weights = _without_ignored(planes, target, weights, counted)
    kind = planes.device.type if planes.dtype == torch.float32 else ""
    if backend == "auto":
        backend = kind if kind in ("cpu", "cuda") else "reference"
    if backend == "reference":
        return _reference(planes, target, ssim_weight, weights)
    if backend not in BACKENDS:
        raise EngineError(f"photo_loss: unknown backend {backend!r}.", f"Use one of {BACKENDS}.")
    if backend == "cpu" and kind != "cpu":
        raise EngineError("photo_loss: the cpu backend takes float32 tensors on the CPU only.")
    terms = _terms_on_cpu if backend == "cpu" else _terms_on_gpu
    return LossOutput(*_KernelLoss.apply(planes, target, ssim_weight, weights, terms))  # type: ignore[no-untyped-call]


def _without_ignored(
    image: Tensor, target: Tensor, weights: Tensor | None, counted: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Image, photo and weights with zeros at ignored pixels; NaN in the image does not get out."""
    shown = counted[..., None]
    zero = image.new_zeros(())
    weights = counted.to(torch.float32) if weights is None else weights * counted
    return torch.where(shown, image, zero), target * shown, weights


def ssim_map(image: Tensor, target: Tensor) -> Tensor:
    """(H, W, 3) twice -> SSIM of every pixel and channel, (H, W, 3); plain torch.

    `target` may be uint8; then it is divided by 255. Any floating dtype and device.
    """
    x, t = image.permute(2, 0, 1), _unit_values(target, image.dtype).permute(2, 0, 1)
    mean_x, mean_t = _filtered(x), _filtered(t)
    variance_x = _filtered(x * x) - mean_x**2
    variance_t = _filtered(t * t) - mean_t**2
    covariance = _filtered(x * t) - mean_x * mean_t
    luminance = (2 * mean_x * mean_t + C1) / (mean_x**2 + mean_t**2 + C1)
    structure = (2 * covariance + C2) / (variance_x + variance_t + C2)
    return (luminance * structure).permute(1, 2, 0)


def _reference(
    image: Tensor, target: Tensor, ssim_weight: float, weights: Tensor | None
) -> LossOutput:
    error = (image - _unit_values(target, image.dtype)).abs().mean(dim=-1)
    difference = 1 - ssim_map(image, target).mean(dim=-1)
    if weights is None:
        l1, dissimilarity = error.mean(), difference.mean()
    else:
        share = weights.to(image.dtype)
        share = share / share.sum().clamp(min=torch.finfo(image.dtype).tiny)
        l1, dissimilarity = (share * error).sum(), (share * difference).sum()
    loss = (1 - ssim_weight) * l1 + ssim_weight * dissimilarity
    return LossOutput(loss, l1.detach(), 1 - dissimilarity.detach())


class _KernelLoss(torch.autograd.Function):
    """Value and gradient from one kernel, on the CPU or a GPU; nothing waits for the GPU."""

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
        # The usual factor of 1 needs no pass over the image; but to read it would wait for a GPU.
        if not ctx.on_cpu or scale != 1:
            gradient.mul_(scale)  # in place: fresh memory costs more. torch refuses a second time
        return gradient.permute(1, 2, 0), *(None,) * 4


def _terms_on_cpu(
    image: Tensor, photo: Tensor, ssim_weight: float, mask: Tensor | None, gradient: Tensor | None
) -> Tensor:
    """(3,) loss, L1 and SSIM by `roigs_photo_loss` of kernels/loss.cpp; fills the gradient."""
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
    """As `_terms_on_cpu`, by cuda/kernels/loss.cu."""
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
    if image.dim() != 3 or shape[2] != 3 or 0 in shape or not image.is_floating_point():
        raise EngineError(f"photo_loss: image is {shape} {image.dtype}, not (H, W, 3) floats.")
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


def _unit_values(image: Tensor, dtype: torch.dtype) -> Tensor:
    return image.to(dtype) / 255 if image.dtype == torch.uint8 else image.to(dtype)


def _filtered(planes: Tensor) -> Tensor:
    """(3, H, W) -> the same size, filtered with the window along columns, then rows."""
    window = _window(planes.dtype, planes.device)
    batch = planes[:, None]
    batch = functional.conv2d(batch, window.view(1, 1, -1, 1), padding=(WINDOW_RADIUS, 0))
    batch = functional.conv2d(batch, window.view(1, 1, 1, -1), padding=(0, WINDOW_RADIUS))
    return batch[:, 0]


@functools.lru_cache(maxsize=8)
def _window(dtype: torch.dtype, device: torch.device) -> Tensor:
    """(11,) Gaussian, sum 1."""
    offsets = torch.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1, dtype=torch.float64)
    window = torch.exp(-(offsets**2) / (2 * WINDOW_SIGMA**2))
    return (window / window.sum()).to(dtype=dtype, device=device)
