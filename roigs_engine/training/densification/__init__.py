"""Density control: what to watch of each Gaussian, when to edit the model, and how.

A scheme is a class behind the interface `DensityControl` in a file of its own; `density_control`
chooses by a stage's settings. `Trainer` knows nothing else of it.

    adaptive    3DGS's adaptive density control (Kerbl et al. 2023, sec. 5.2)
    in_box      the same confined to boxes (ROI-GS, sec. II-B), with a budget for each
    none        the Gaussians stay as they are
"""

from __future__ import annotations

from .adaptive import AdaptiveDensity
from .edits import Edit
from .in_box import InBoxDensity
from .interface import DensityControl, DensityInputs
from .none import FixedDensity

__all__ = ["DensityControl", "DensityInputs", "Edit", "density_control"]


def density_control(inputs: DensityInputs, count: int) -> DensityControl:
    """The density control of a stage that starts with `count` Gaussians."""
    config = inputs.config
    if config.densify_until <= config.densify_from and not config.contribution_every:
        return FixedDensity()
    if config.densify_in_boxes or config.box_grad_threshold or inputs.budgets:
        return InBoxDensity(inputs, count)
    return AdaptiveDensity(inputs, count)
