"""The interface that every scheme of density control has."""

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
    """What a scheme may go by.

    Attributes:
        config: of the stage.
        extent: of the scene, world units.
        rois: the stage's boxes.
        budgets: of each box; None: no limit.
        photos: how many the stage trains on.
        seed: of what is drawn at random; together with the step it decides the numbers.
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
        """Take one training view in; all arguments (N,), see `rasterize.RenderOutput`."""
        ...

    def edit(self, gaussians: Gaussians, step: int) -> Edit | None:
        """What to change after `step` steps; None: nothing. The caller carries it out."""
        ...

    def follow(self, rows: Tensor) -> None:
        """The model's rows have changed by somebody else's edit, see `Edit.rows`."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """What `load_state_dict` needs to continue exactly."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from what `state_dict` returned."""
        ...
