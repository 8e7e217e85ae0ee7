"""The steps that the panel shows are those that the engine takes."""

from __future__ import annotations

from pathlib import Path

import pytest

from roigs_addon.engine.training_steps import PRESET_STEPS, training_steps
from roigs_engine.run.presets import PRESETS


def test_all_presets_are_known() -> None:
    assert list(PRESET_STEPS) == sorted(PRESETS, key=list(PRESET_STEPS).index)


@pytest.mark.parametrize("factor", [0.001, 0.33333, 1.0, 2.5])
@pytest.mark.parametrize("strategy", ["joint", "independent"])
@pytest.mark.parametrize("preset", ["draft", "standard", "paper"])
def test_steps_are_the_engines(preset: str, strategy: str, factor: float) -> None:
    pytest.importorskip("torch")
    from roigs_engine.app.asked import run_config
    from roigs_engine.requests.runs import Train
    from roigs_engine.run.stage_configs import cutout_stage, object_stage
    from roigs_engine.training.mechanisms.masked_steps import MaskedSteps

    asked = Train(
        scene=Path("garden"),
        run_dir=Path("run"),
        preset=preset,
        strategy=strategy,
        steps_factor=float(f"{factor:.5g}"),
    )
    config = run_config(asked)
    boxes, cutout = 3, 0
    if strategy == "joint":
        masks = config.roi.of(MaskedSteps)
        more = masks.reinvested * (1 - masks.whole_share)
        steps = config.scene.steps + round((1 + more) * config.roi.steps)
        cutout = cutout_stage(config).steps
    else:
        steps = config.scene.steps + boxes * object_stage(config).steps + config.refine_steps
    assert training_steps(preset, strategy, factor, boxes) == steps
    assert training_steps(preset, strategy, factor, boxes, masks=True) == steps + cutout
