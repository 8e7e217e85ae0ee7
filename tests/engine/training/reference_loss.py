"""The training loss in plain torch, for any floating dtype: what the kernels are compared with."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from roigs_engine.training import losses
from roigs_engine.training.losses import LossOutput

WINDOW_RADIUS = 5
WINDOW_SIGMA = 1.5
C1 = 0.01**2
C2 = 0.03**2


def photo_loss(
    image: Tensor,
    target: Tensor,
    *,
    ssim_weight: float = 0.2,
    weights: Tensor | None = None,
    counted: Tensor | None = None,
    backend: str = "auto",
) -> LossOutput:
    """As the engine's; the backend may also be "reference"."""
    if backend != "reference":
        options: dict[str, Any] = {"weights": weights, "counted": counted, "backend": backend}
        return losses.photo_loss(image, target, ssim_weight=ssim_weight, **options)
    image = image.squeeze(0) if image.dim() == 4 else image
    losses._check(image.float(), target, weights, counted)
    if counted is not None:
        image, target, weights = losses._without_ignored(image, target, weights, counted)
    error = (image - unit_values(target, image.dtype)).abs().mean(dim=-1)
    difference = 1 - ssim_map(image, target).mean(dim=-1)
    if weights is None:
        l1, dissimilarity = error.mean(), difference.mean()
    else:
        share = weights.to(image.dtype)
        share = share / share.sum().clamp(min=torch.finfo(image.dtype).tiny)
        l1, dissimilarity = (share * error).sum(), (share * difference).sum()
    loss = (1 - ssim_weight) * l1 + ssim_weight * dissimilarity
    return LossOutput(loss, l1.detach(), 1 - dissimilarity.detach())


def ssim_map(image: Tensor, target: Tensor) -> Tensor:
    """(H, W, 3) twice -> SSIM of every pixel and channel, (H, W, 3); a uint8 target: by 255."""
    x, t = image.permute(2, 0, 1), unit_values(target, image.dtype).permute(2, 0, 1)
    mean_x, mean_t = filtered(x), filtered(t)
    variance_x = filtered(x * x) - mean_x**2
    variance_t = filtered(t * t) - mean_t**2
    covariance = filtered(x * t) - mean_x * mean_t
    luminance = (2 * mean_x * mean_t + C1) / (mean_x**2 + mean_t**2 + C1)
    structure = (2 * covariance + C2) / (variance_x + variance_t + C2)
    return (luminance * structure).permute(1, 2, 0)


def unit_values(image: Tensor, dtype: torch.dtype) -> Tensor:
    return image.to(dtype) / 255 if image.dtype == torch.uint8 else image.to(dtype)


def filtered(planes: Tensor) -> Tensor:
    """(3, H, W) -> the same size, filtered with the window along columns, then rows."""
    offsets = torch.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1, dtype=torch.float64)
    window = torch.exp(-(offsets**2) / (2 * WINDOW_SIGMA**2))
    window = (window / window.sum()).to(dtype=planes.dtype, device=planes.device)
    batch = planes[:, None]
    batch = functional.conv2d(batch, window.view(1, 1, -1, 1), padding=(WINDOW_RADIUS, 0))
    batch = functional.conv2d(batch, window.view(1, 1, 1, -1), padding=(0, WINDOW_RADIUS))
    return batch[:, 0]
