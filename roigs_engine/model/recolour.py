"""The colours of Gaussians made brighter, darker or tinted."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from .gaussians import SH_C0


def recoloured(sh: Tensor, gains: Sequence[float]) -> Tensor:
    """SH coefficients whose colours are `gains` times as large, seen from anywhere.

    Args:
        sh: (N, K, 3); a colour is max(0, 0.5 + sum of sh * basis), sRGB.
        gains: of red, green and blue, not negative. A gain of 1 keeps its channel bit for bit.
    """
    factors = torch.as_tensor(gains, dtype=sh.dtype, device=sh.device)
    changed = sh * factors
    changed[:, 0] += 0.5 * (factors - 1) / SH_C0
    return changed
