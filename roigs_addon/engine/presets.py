"""The engine's presets, for Blender's menus. No bpy."""

from __future__ import annotations

from typing import Any

from ..shared import targets
from .training_steps import PAPER, PRESET_STEPS

PRESETS = (
    ("draft", "Draft", f"{sum(PRESET_STEPS['draft']):,} steps: minutes on a CPU"),
    ("standard", "Standard", f"{sum(PRESET_STEPS['standard']):,} steps"),
    (
        "paper",
        "Paper",
        f"{sum(PRESET_STEPS['paper']):,} steps, boxes one by one, photos chosen by the paper's"
        " Gaussian process",
    ),
)
PAPER_DEFAULTS = {"strategy": "independent", "method": "gp9", "made_for": targets.PLAIN.name}
JOINT_DEFAULTS = {"strategy": "joint", "method": "coverage"}


def follow_preset(settings: Any, made_for: str) -> None:
    """Change defaults when the preset changes to the paper's or back; the user's choices stay.

    Args:
        settings: of a scene.
        made_for: default of the other presets.
    """
    now_paper = settings.preset == PAPER
    if now_paper == settings.is_paper:
        return
    settings.is_paper = now_paper
    left, taken = JOINT_DEFAULTS | {"made_for": made_for}, PAPER_DEFAULTS
    if not now_paper:
        left, taken = taken, left
    for name, value in taken.items():
        if getattr(settings, name) == left[name]:
            setattr(settings, name, value)
