"""No density control: the set of Gaussians does not change."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from ...model.gaussians import Gaussians
from .edits import Edit


class FixedDensity:
    """Keeps no statistics and makes no edits."""

    needs_max_weight = False

    def observe(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        """Does nothing."""

    def is_due(self, step: int) -> bool:
        """Never."""
        return False

    def edit(self, gaussians: Gaussians, step: int) -> Edit | None:
        """Always None."""
        return None

    def follow(self, rows: Tensor) -> None:
        """Does nothing."""

    def state_dict(self) -> dict[str, Any]:
        """An empty state."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Does nothing."""
