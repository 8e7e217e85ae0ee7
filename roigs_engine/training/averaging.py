"""The mean of the models that training went through (Polyak and Juditsky 1992).

Adam at a steady rate never comes to rest: each photo pulls the model towards itself, most of all
where photos differ in exposure. The mean over many steps is nearer to what suits all of them, and
unlike falling rates it does not slow learning down (docs/results.md has both).
"""

from __future__ import annotations

from typing import Any

import torch

from ..model.gaussians import NAMES, Gaussians


class ModelMean:
    """Sum of models with the same rows.

    Attributes:
        count: how many models are in it.
    """

    def __init__(self) -> None:
        self.count = 0
        self._sums: dict[str, torch.Tensor] = {}

    @torch.no_grad()
    def add(self, model: Gaussians) -> None:
        """Take a model in."""
        self.count += 1
        for name, tensor in model.tensors().items():
            if name in self._sums:
                self._sums[name] += tensor
            else:
                self._sums[name] = tensor.detach().clone()

    def clear(self) -> None:
        """Forget all models: rows are about to change."""
        self.count, self._sums = 0, {}

    def mean(self) -> Gaussians:
        """The mean of every parameter as it is stored (logarithms, logits, unscaled rotations)."""
        return Gaussians(**{name: self._sums[name] / self.count for name in NAMES})

    def state_dict(self) -> dict[str, Any]:
        """What `load_state_dict` takes."""
        return {"count": self.count, "sums": dict(self._sums)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        self.count, self._sums = int(state["count"]), dict(state["sums"])
