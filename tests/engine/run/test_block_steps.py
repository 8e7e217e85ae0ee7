"""The steps of a block: each photo is used as often as in a scene that is not cut."""

from __future__ import annotations

import pytest

from roigs_engine.run.presets import PRESETS
from roigs_engine.run.stage_configs import block_stage, shortened, surroundings_stage
from roigs_engine.training.config import TrainConfig


def densifications(config: TrainConfig) -> int:
    steps = range(config.densify_from, config.densify_until)
    return sum(step > 0 and step % config.densify_every == 0 for step in steps)


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
    assert near.full_every > far.full_every >= 2
    for config in (near, far):
        assert config.steps / config.full_every == pytest.approx(0.3 * whole.steps, rel=0.4)
        assert config.outside_rate == 0 < whole.outside_rate
    none = surroundings_stage(whole, 0.5)
    assert none.full_every == 1 and none.steps == pytest.approx(0.3 * whole.steps, abs=1)
    assert not none.densify_in_boxes and none.grad_threshold == whole.outside_grad_threshold


def test_without_masks_a_share_is_a_share() -> None:
    paper = PRESETS["paper"]()
    assert surroundings_stage(paper.scene, 0.25).steps == 5000
    assert block_stage(paper.roi, share=0.5, photos=0.25).steps == 15_000
    assert surroundings_stage(paper.roi, 0.25).densify_until == 0  # none is added outside boxes
