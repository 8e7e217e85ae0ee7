"""What training has seen of each Gaussian since the last edit."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass
class DensityStats:
    """Sums over training views.

    Attributes:
        gradient: (N,) sum of 2D gradient norms (`RenderOutput.grad2d`).
        views: (N,) number of views that saw it.
        weight: (N,) largest alpha x T on any training pixel of the present window; infinite for
            Gaussians born in it, which not every photo has seen yet.
    """

    gradient: Tensor
    views: Tensor
    weight: Tensor

    @classmethod
    def zeros(cls, count: int, device: torch.device | None = None) -> DensityStats:
        """Statistics of `count` Gaussians that nothing has seen."""
        return cls(*(torch.zeros(count, device=device) for _ in range(3)))

    def add(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        """Take one training view in; all arguments (N,)."""
        self.gradient += grad2d
        self.views += visible
        if max_weight is not None:
            torch.maximum(self.weight, max_weight, out=self.weight)

    def mean_gradient(self) -> Tensor:
        """(N,) mean gradient norm over the views that saw each Gaussian."""
        return self.gradient / self.views.clamp(min=1)

    def after(self, rows: Tensor) -> DensityStats:
        """Statistics for edited Gaussians: gradients start anew, weights follow their rows."""
        fresh = DensityStats.zeros(len(rows), rows.device)
        fresh.weight = torch.where(rows >= 0, self.weight[rows.clamp(min=0)], torch.inf)
        return fresh

    def new_window(self) -> None:
        """Begin to measure the weights anew."""
        self.weight.zero_()
