"""The interface of all density control schemes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from ...model.gaussians import Gaussians
from ...model.roi import OrientedBox
from ..budget import BoxBudget
from ..config import TrainConfig
from .edits import Edit


@dataclass(frozen=True, kw_only=True, eq=False)
class DensityInputs:
    """The inputs of a scheme.

    Attributes:
        config: of the stage.
        extent: of the scene, world units.
        rois: the stage's boxes.
        budgets: Gaussian budget of each box; None: no limit.
        photos: number of the stage's photos.
        seed: random numbers are a function of seed and step.
        device: where the statistics are kept.
    """

    config: TrainConfig
    extent: float
    rois: Sequence[OrientedBox]
    budgets: Sequence[BoxBudget] | None
    photos: int
    seed: int
    device: torch.device


class DensityControl(Protocol):
    """Adds and removes Gaussians while a stage trains."""

    @property
    def needs_max_weight(self) -> bool:
        """Whether `observe` needs each Gaussian's largest blending weight."""
        ...

    def observe(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        """Add the statistics of one training view; all (N,), see `rasterize.RenderOutput`."""
        ...

    def is_due(self, step: int) -> bool:
        """Whether `edit` may make one after `step` steps; it costs nothing to ask."""
        ...

    def edit(self, gaussians: Gaussians, step: int) -> Edit | None:
        """The edit that is due after `step` steps, for the caller to apply; None: no edit."""
        ...

    def follow(self, rows: Tensor) -> None:
        """Update the statistics after another edit of the model's rows, see `Edit.rows`."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """The state, as `load_state_dict` needs it to continue exactly."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a `state_dict`."""
        ...
