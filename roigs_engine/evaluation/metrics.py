"""PSNR, SSIM and FLIP of a render against its photo, over all pixels or over a mask.

Images are (H, W, 3) sRGB values in [0, 1]; masks are (H, W) bool. Higher is better, except for
FLIP.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from ..training.losses import photo_loss

# PSNR of equal images in dB, which is that of a mean squared error of 1e-10. It keeps means and
# JSON finite, and is far above the PSNR that 8-bit photos can reach.
MAX_PSNR = 100.0
SSIM_RADIUS = 5  # half of the 11 x 11 window
DETAIL_SIGMA = 2.0  # pixels; structures smaller than about 10 pixels are detail


def psnr_from_mse(mse: float) -> float:
    """Return PSNR in dB of a mean squared error in [0, 1]; at most `MAX_PSNR`, NaN for NaN."""
    return MAX_PSNR if mse <= 1e-10 else -10.0 * math.log10(mse)


def squared_error(image: Tensor, target: Tensor) -> Tensor:
    """(H, W, 3) twice -> (H, W) squared error, averaged over the channels."""
    return ((image - target) ** 2).mean(dim=-1)


def mean_in(values: Tensor, mask: Tensor | None = None) -> float:
    """Return the mean of (H, W) values in a mask, summed in float64; NaN for an empty mask."""
    picked = values if mask is None else values[mask]
    return float(picked.double().mean()) if picked.numel() else math.nan


def corrected_error(image: Tensor, target: Tensor, mask: Tensor) -> float:
    """Return the mean squared error in a mask after scaling each channel to fit best.

    So another exposure or white balance of the render is no error. NaN for an empty mask.
    """
    shown, wanted = image[mask].double(), target[mask].double()
    factors = (shown * wanted).sum(dim=0) / (shown**2).sum(dim=0).clamp(min=1e-10)
    return mean_in(((shown * factors).clamp(0, 1) - wanted) ** 2)


def detail_error(image: Tensor, target: Tensor, mask: Tensor) -> float:
    """Return the mean squared error in a mask after subtracting a blur (sigma `DETAIL_SIGMA`).

    The blur is Gaussian. Errors of brightness and of large areas hardly count, so a blurred render
    is worse than one with another brightness. NaN for an empty mask.
    """
    radius = math.ceil(3 * DETAIL_SIGMA)
    box = bounding_box(mask, margin=radius)
    if box is None:
        return math.nan
    error = (image[box] - target[box]).permute(2, 0, 1)[:, None].double()
    at = torch.arange(-radius, radius + 1, dtype=error.dtype, device=error.device)
    window = torch.exp(-0.5 * (at / DETAIL_SIGMA) ** 2)
    window /= window.sum()
    padded = torch.nn.functional.pad(error, (radius,) * 4, mode="replicate")
    blurred = torch.nn.functional.conv2d(padded, window[None, None, :, None])
    blurred = torch.nn.functional.conv2d(blurred, window[None, None, None, :])
    return mean_in(((error - blurred)[:, 0] ** 2).mean(dim=0), mask[box])


def ssim(
    image: Tensor,
    photo: Tensor,  # (H, W, 3) uint8
    mask: Tensor,
    counted: Tensor | None = None,  # (H, W) bool
) -> float:
    """Return structural similarity (Wang et al. 2004): 11 x 11 Gaussian window, sigma 1.5.

    The SSIM map is that of the full images, averaged over the channels; the result is its mean over
    the mask. Only the mask's bounding box, widened by the window's radius, is computed. NaN for an
    empty mask. `counted` are the pixels that the photo's own mask does not ignore. The others are
    treated as in `photo_loss`, and must not be in `mask`.
    """
    box = bounding_box(mask, margin=SSIM_RADIUS)
    if box is None:
        return math.nan
    weights, counted = mask[box].to(image), None if counted is None else counted[box]
    return float(photo_loss(image[box], photo[box], weights=weights, counted=counted).ssim)


def bounding_box(mask: Tensor, margin: int = 0) -> tuple[slice, slice] | None:
    """Return rows and columns of a mask's bounding box, widened by `margin` pixels; None if empty.

    The result is clipped to the image.
    """
    rows, columns = torch.nonzero(mask.any(dim=1)), torch.nonzero(mask.any(dim=0))
    if len(rows) == 0:
        return None
    height, width = mask.shape
    top, bottom = int(rows[0]) - margin, int(rows[-1]) + 1 + margin
    left, right = int(columns[0]) - margin, int(columns[-1]) + 1 + margin
    return slice(max(top, 0), min(bottom, height)), slice(max(left, 0), min(right, width))


# The largest distance at which a pixel changes FLIP's error, at 67 pixels per degree (the
# package's default: a 0.7 m wide screen of 3,840 pixels, 0.7 m away).
FLIP_RADIUS = 10
PIXELS_AT_ONCE = 1 << 20  # about; the package takes 120 bytes per pixel


def flip(
    image: Tensor,  # (H, W, 3) in [0, 1]
    target: Tensor,  # (H, W, 3) in [0, 1]
    mask: Tensor,  # (H, W) bool
) -> float | None:
    """Return the mean FLIP error over the mask's pixels, from 0 (equal) to 1; lower is better.

    FLIP measures how different two pictures look to a person who flips between them (Andersson et
    al. 2020, "FLIP: A Difference Evaluator for Alternating Images"). NVIDIA's package
    `flip-evaluator` computes it, if it is installed (extra `flip`).

    The error is that of the whole pictures, but only the mask's bounding box, widened by the
    filters' radius, is computed, some rows at a time. None without the package, or for an empty
    mask.
    """
    try:
        from flip_evaluator import evaluate
    except ImportError:
        return None
    height = max(PIXELS_AT_ONCE // mask.shape[1], 1)
    total, count = 0.0, 0
    for top in range(0, len(mask), height):
        strip = torch.zeros_like(mask)
        strip[top : top + height] = mask[top : top + height]
        box = bounding_box(strip, margin=FLIP_RADIUS)
        if box is None:
            continue
        reference, test = (np.ascontiguousarray(x[box].cpu().numpy()) for x in (target, image))
        errors = evaluate(reference, test, "LDR", applyMagma=False, computeMeanError=False)[0]
        picked = errors[..., 0][strip[box].cpu().numpy()]
        total, count = total + float(picked.sum(dtype=np.float64)), count + len(picked)
    return total / count if count else None
