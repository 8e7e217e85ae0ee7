"""No density control: the Gaussians stay as many as they are."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from ...model.gaussians import Gaussians
from .edits import Edit


class FixedDensity:
    """Watches nothing, edits nothing."""

    needs_max_weight = False

    def observe(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        """Nothing is watched."""

    def edit(self, gaussians: Gaussians, step: int) -> Edit | None:
        """Never anything."""
        return None

    def follow(self, rows: Tensor) -> None:
        """There are no statistics."""

    def state_dict(self) -> dict[str, Any]:
        """Empty."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Nothing to continue from."""
