"""Outside the boxes, learning rates are larger in steps on whole photos; opacities decay less."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.run import stage_configs
from roigs_engine.run.presets import PRESETS, in_strategy, preset
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.masked_steps import MaskedSteps
from roigs_engine.training.mechanisms.surroundings_rate import SurroundingsRate
from roigs_engine.training.trainer import Trainer
from tests.engine.synthetic_scene import BOX, make_scene, stage_data

PLAIN = TrainConfig(steps=30, mechanisms=(MaskedSteps(whole_share=0.5),))
CONFIG = PLAIN.using(SurroundingsRate(factor=4.0))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def trainer(scene: SfmScene, config: TrainConfig) -> Trainer:
    data = stage_data(scene, rois=[BOX])
    return Trainer(Gaussians.from_points(scene.points, scene.colors), data, config)


def values(of: Trainer) -> Tensor:
    """(N, P): all parameters of the Gaussians."""
    tensors = of.gaussians.tensors().values()
    return torch.cat([t.detach().reshape(len(t), -1) for t in tensors], dim=1).clone()


def inside(of: Trainer) -> Tensor:
    """(N,) bool"""
    return torch.from_numpy(BOX.contains(of.gaussians.means.detach().double().numpy()))


def test_factors_follow_the_boxes(scene: SfmScene) -> None:
    fast = trainer(scene, CONFIG)
    rates = fast._row_rates(whole=True)
    assert rates is not None and rates.dtype == torch.float32
    assert torch.equal(rates, torch.where(inside(fast), 1.0, 4.0))
    assert fast._row_rates(whole=False) is None
    assert trainer(scene, PLAIN)._row_rates(whole=True) is None


def test_only_whole_photos_move_what_is_outside_farther(scene: SfmScene) -> None:
    """The second step is on a whole photo; what differs after it stays."""
    fast, plain = trainer(scene, CONFIG), trainer(scene, PLAIN)
    fast.train_step(), plain.train_step()
    assert fast.optimizer.row_rates is None  # this step is on a mask
    start, within = values(fast), inside(fast)
    assert torch.equal(start, values(plain))
    assert within.any() and not within.all()
    fast.train_step(), plain.train_step()
    moved, usual = values(fast) - start, values(plain) - start
    assert torch.equal(moved[within], usual[within])
    seen = (usual != 0) & ~within[:, None]
    assert seen.any() and torch.allclose(moved[seen], 4 * usual[seen], rtol=1e-3, atol=1e-6)
    assert fast.optimizer.row_rates is not None
    fast.train_step()
    assert fast.optimizer.row_rates is None


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_who_has_them(name: str) -> None:
    """Only the box stage of a whole scene: it was measured there."""
    config = in_strategy(preset(name), "joint")
    assert config.roi.get(SurroundingsRate) and not config.scene.get(SurroundingsRate)
    tuned = stage_configs.tuned_baseline(config)
    others = [
        tuned.fine,
        stage_configs.baseline(config),
        stage_configs.cutout_stage(config),
        stage_configs.refine_stage(in_strategy(config, "independent")),
        stage_configs.block_stage(config.roi, 0.5, 0.5),
        stage_configs.surroundings_stage(config.roi, 0.5),
    ]
    assert not any(other.get(SurroundingsRate) for other in others)


def test_a_stopped_stage_keeps_who_is_outside(scene: SfmScene) -> None:
    """Gaussians may have crossed a box's side since that was found."""
    whole, stopped = trainer(scene, CONFIG), trainer(scene, CONFIG)
    for _ in range(4):
        whole.train_step(), stopped.train_step()
    for one in (whole, stopped):  # as if they had crossed: a new trainer would find others
        one.state_dict()["mechanisms"]["surroundings_rate"]["outside"][::2] ^= True
    resumed = trainer(scene, CONFIG)
    resumed.load_state_dict(stopped.state_dict())
    for _ in range(5):
        whole.train_step(), resumed.train_step()
    assert torch.equal(values(whole), values(resumed))
