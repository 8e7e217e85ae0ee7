"""Converts sRGB values to linear light and back (IEC 61966-2-1), also above 1; differentiable."""

from __future__ import annotations

import torch
from torch import Tensor


def to_linear(values: Tensor) -> Tensor:
    """Convert sRGB values of 0 or more to linear light."""
    power = ((values.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(values > 0.04045, power, values / 12.92)


def to_srgb(light: Tensor) -> Tensor:
    """Convert linear light of 0 or more to sRGB values."""
    power = 1.055 * light.clamp(min=0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(light > 0.0031308, power, 12.92 * light)
