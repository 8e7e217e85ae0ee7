"""The steps of a block: each photo is used as often as in a scene that is not cut."""

from __future__ import annotations

import pytest

from roigs_engine.run.presets import PRESETS
from roigs_engine.run.stage_configs import block_stage, shortened, surroundings_stage
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.box_density_control import BoxDensityControl
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.masked_steps import MaskedSteps
from roigs_engine.training.mechanisms.surroundings_rate import SurroundingsRate


def densifications(config: TrainConfig) -> int:
    return sum(map(config.of(DensityControl).grows, range(1, config.steps + 1)))


@pytest.mark.parametrize("preset", sorted(PRESETS))
@pytest.mark.parametrize("factor", [0.1, 0.45, 1, 2])
@pytest.mark.parametrize("share", [0.13, 0.49, 0.82, 1.0])
def test_a_block_densifies_as_often(preset: str, factor: float, share: float) -> None:
    config = PRESETS[preset]().scaled(factor)
    for whole in (config.scene, config.roi):
        short = shortened(whole, share)
        assert short.steps == pytest.approx(share * whole.steps, abs=0.51)
        assert densifications(short) == pytest.approx(densifications(whole), abs=1)
        assert short.sh_degree == whole.sh_degree and short.lr_means == whole.lr_means


def test_boxes_and_whole_photos_have_their_shares() -> None:
    whole = PRESETS["standard"]().roi
    near = block_stage(whole, share=1.0, photos=0.5)
    far = block_stage(whole, share=0.1, photos=0.5)
    assert near.of(MaskedSteps).whole_share < far.of(MaskedSteps).whole_share < 1
    for config in (near, far):
        masks = config.of(MaskedSteps)
        assert config.steps * masks.whole_share == pytest.approx(0.3 * whole.steps, rel=0.01)
        assert config.get(SurroundingsRate) is None is not whole.get(SurroundingsRate)
    none = surroundings_stage(whole, 0.5)
    assert none.get(MaskedSteps) is None and none.steps == pytest.approx(0.3 * whole.steps, abs=1)
    density = none.of(DensityControl)
    assert type(density) is DensityControl
    assert density.grad_threshold == whole.of(BoxDensityControl).outside_threshold


def test_without_masks_a_share_is_a_share() -> None:
    paper = PRESETS["paper"]()
    assert surroundings_stage(paper.scene, 0.25).steps == 5000
    assert block_stage(paper.roi, share=0.5, photos=0.25).steps == 15_000
    assert surroundings_stage(paper.roi, 0.25).get(DensityControl) is None  # none outside boxes
