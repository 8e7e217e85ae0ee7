"""The mean of the models of the last steps (Polyak and Juditsky 1992).

At a constant learning rate Adam does not converge: each step fits the model to its own photo, most
of all where photos differ in exposure. The mean over many steps fits all photos better. Unlike a
decaying learning rate it does not slow learning down (notebook/steps_and_budgets.md compares both).
"""

from __future__ import annotations

from typing import Any

import torch

from ..model.gaussians import NAMES, Gaussians


class ModelMean:
    """Sum of models with the same rows.

    Attributes:
        count: number of models in the sum.
    """

    def __init__(self) -> None:
        self.count = 0
        self._sums: dict[str, torch.Tensor] = {}

    @torch.no_grad()
    def add(self, model: Gaussians) -> None:
        """Add a model."""
        self.count += 1
        for name, tensor in model.tensors().items():
            if name in self._sums:
                self._sums[name] += tensor
            else:
                self._sums[name] = tensor.detach().clone()

    def clear(self) -> None:
        """Drop all models; needed before rows change."""
        self.count, self._sums = 0, {}

    def mean(self) -> dict[str, torch.Tensor]:
        """The mean of each parameter in its stored form (log scales, logits, raw quaternions)."""
        return {name: self._sums[name] / self.count for name in NAMES}

    def state_dict(self) -> dict[str, Any]:
        """The state, as `load_state_dict` takes it."""
        return {"count": self.count, "sums": dict(self._sums)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a `state_dict`."""
        self.count, self._sums = int(state["count"]), dict(state["sums"])
