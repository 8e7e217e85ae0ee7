"""Computes the number of steps of a training without the engine. No bpy.

The numbers are copies of the engine's (roigs_engine/run/presets.py); a test compares them.
"""

from __future__ import annotations

PRESET_STEPS = {"draft": (2000, 3000), "standard": (4000, 4500), "paper": (20_000, 30_000)}
"""Preset -> steps of the scene, and of the boxes."""
REFINE_SHARE = 0.2
"""Share of the boxes' steps for the joint stage after boxes trained one by one."""
CUTOUT_SHARE = 0.6
"""Share of the boxes' steps for the stage that cuts objects out; only with object masks."""
MORE_WHOLE_SHARE = 1 / 3
"""Largest share of the boxes' steps added on whole photos if boxes are small."""
PAPER = "paper"
MOST_FACTOR = 1e6


def _preset(name: str) -> tuple[int, int]:
    """Return the steps of a preset; those of 'standard' if this version does not know it."""
    return PRESET_STEPS.get(name, PRESET_STEPS["standard"])


def stage_steps(preset: str, factor: float) -> tuple[int, int]:
    """Return a preset's steps of the scene and of the boxes, multiplied by a factor."""
    usable = factor if 0 < factor < MOST_FACTOR else 1.0  # a .blend may have any number
    scene, roi = (max(1, round(steps * usable)) for steps in _preset(preset))
    return scene, roi


def training_steps(
    preset: str, strategy: str, factor: float, boxes: int, *, masks: bool = False
) -> int:
    """Return the largest number of steps of all stages; `masks`: there are object masks."""
    scene, roi = stage_steps(preset, factor)
    if strategy == "joint":
        more = round((1 + MORE_WHOLE_SHARE) * roi)
        return scene + more + (max(1, round(CUTOUT_SHARE * roi)) if masks else 0)
    refine = 0 if preset == PAPER else round(REFINE_SHARE * roi)
    return scene + boxes * (roi - refine) + refine
