"""Density control: which statistics to keep of each Gaussian, and when and how to edit the model.

Each scheme is a class with the interface `DensityControl`, in its own file. `density_control`
chooses one by the stage's settings. `Trainer` uses only the interface.

    adaptive    3DGS's adaptive density control (Kerbl et al. 2023, sec. 5.2)
    in_box      the same limited to boxes (ROI-GS, sec. II-B), with a Gaussian budget for each box
    none        the set of Gaussians does not change
"""

from __future__ import annotations

from ..config import TrainConfig
from .adaptive import AdaptiveDensity
from .edits import Edit
from .in_box import InBoxDensity
from .interface import DensityControl, DensityInputs
from .none import FixedDensity

__all__ = ["DensityControl", "DensityInputs", "Edit", "density_control", "keeps_statistics"]


def keeps_statistics(config: TrainConfig) -> bool:
    """Whether the stage adds or removes Gaussians by statistics of each."""
    return config.densify_until > config.densify_from or config.contribution_every > 0


def density_control(inputs: DensityInputs, count: int) -> DensityControl:
    """The density control of a stage that starts with `count` Gaussians."""
    config = inputs.config
    if not keeps_statistics(config):
        return FixedDensity()
    if config.densify_in_boxes or config.box_grad_threshold or inputs.budgets:
        return InBoxDensity(inputs, count)
    return AdaptiveDensity(inputs, count)
