"""FLIP: how different two pictures look to a person who flips between them.

Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images". NVIDIA's package
`flip-evaluator` computes it, if it is installed (extra `flip`).
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .metrics import bounding_box

# The largest distance at which a pixel changes FLIP's error, at 67 pixels per degree (the
# package's default: a 0.7 m wide screen of 3,840 pixels, 0.7 m away).
FLIP_RADIUS = 10
PIXELS_AT_ONCE = 1 << 20  # about; the package takes 120 bytes for each


def flip(
    image: Tensor,  # (H, W, 3) in [0, 1]
    target: Tensor,  # (H, W, 3) in [0, 1]
    mask: Tensor,  # (H, W) bool
) -> float | None:
    """Mean FLIP error over the mask's pixels, from 0 (equal) to 1; lower is better.

    The error is that of the whole pictures, but only the mask's bounding rectangle, widened by the
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
