"""Statistics of each Gaussian since the last edit."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass
class DensityStats:
    """Sums over training views.

    Attributes:
        gradient: (N,) sum of 2D gradient norms (`RenderOutput.grad2d`).
        views: (N,) number of views that showed it.
        weight: (N,) largest alpha x T on any training pixel of the current window; Inf for
            Gaussians added in this window, since some photos have not been drawn after that.
    """

    gradient: Tensor
    views: Tensor
    weight: Tensor

    @classmethod
    def zeros(cls, count: int, device: torch.device | None = None) -> DensityStats:
        """Empty statistics of `count` Gaussians."""
        return cls(*(torch.zeros(count, device=device) for _ in range(3)))

    def add(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        """Add one training view; all arguments (N,)."""
        self.gradient += grad2d
        self.views += visible
        if max_weight is not None:
            torch.maximum(self.weight, max_weight, out=self.weight)

    def mean_gradient(self) -> Tensor:
        """(N,) mean gradient norm over the views that showed each Gaussian."""
        return self.gradient / self.views.clamp(min=1)

    def after(self, rows: Tensor) -> DensityStats:
        """Statistics for edited rows: gradients restart at zero, weights stay with their rows."""
        fresh = DensityStats.zeros(len(rows), rows.device)
        fresh.weight = torch.where(rows >= 0, self.weight[rows.clamp(min=0)], torch.inf)
        return fresh

    def new_window(self) -> None:
        """Start a new window: reset the weights."""
        self.weight.zero_()
