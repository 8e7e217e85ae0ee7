"""Opacities that decay as the photos go round."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from roigs_engine.errors import ConfigError
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.run.presets import preset
from roigs_engine.run.stage_configs import baseline, block_stage, tuned_baseline
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.opacity_decay import OpacityDecay, decay_opacities
from roigs_engine.training.trainer import Trainer
from tests.engine.synthetic_scene import make_scene, stage_data


@pytest.mark.parametrize("share", [1e-4, 0.025, 0.5, 0.999])
def test_each_opacity_loses_that_share(share: float) -> None:
    logits = torch.linspace(-12, 12, 49, dtype=torch.float64)
    before = logits.sigmoid()
    decay_opacities(logits, share)
    torch.testing.assert_close(logits.sigmoid(), (1 - share) * before)


def test_nothing_becomes_infinite() -> None:
    logits = torch.tensor([-200.0, -90.0, 0.0, 90.0, 200.0])
    decay_opacities(logits, 0.025)
    assert logits.isfinite().all()
    assert logits[0] < -199
    assert logits[-1].sigmoid() == pytest.approx(0.975)


def test_no_decay_changes_no_bit() -> None:
    logits = torch.linspace(-12, 12, 49)
    before = logits.clone()
    decay_opacities(logits, 0.0)
    assert torch.equal(logits, before)


def test_it_is_due_once_a_round_of_the_photos(tmp_path: Path) -> None:
    config = TrainConfig(steps=60, mechanisms=(OpacityDecay(share=0.1),))
    due = {}
    for photos in (3, 25):
        scene = make_scene(tmp_path, views=photos)
        model = Gaussians.from_points(scene.points, scene.colors)
        running = Trainer(model, stage_data(scene), config)._running["opacity_decay"]
        due[photos] = [step for step in range(1, 61) if running.is_due(step)]
    assert due == {3: [10, 20, 30, 40, 50], 25: [25, 50]}


@pytest.mark.parametrize("share", [-0.1, 1.0])
def test_a_share_is_less_than_one(share: float) -> None:
    with pytest.raises(ConfigError, match="opacity_decay"):
        TrainConfig(steps=9, mechanisms=(OpacityDecay(share=share),))


def test_what_no_photo_shows_fades_and_the_rest_stays(tmp_path: Path) -> None:
    scene = make_scene(tmp_path)
    images = scene.images[:4]  # a quarter of the ring
    data = stage_data(replace(scene, images=images), extent=scene.extent())
    shown = Gaussians.from_points(scene.points, scene.colors)
    place = 3 * np.mean([image.centre for image in images], axis=0, keepdims=True)
    behind = Gaussians.from_points(place, scene.colors[:1])  # the cameras
    config = TrainConfig(steps=101, mechanisms=(OpacityDecay(share=0.05),))
    trainer = Trainer(Gaussians.concatenate([shown, behind]), data, config)
    far = trainer.gaussians.means.detach().norm(dim=1).argmax()
    first = trainer.gaussians.logit_opacities.detach().sigmoid().clone()
    assert trainer.run()
    last = trainer.gaussians.logit_opacities.detach().sigmoid()
    assert last[far] == pytest.approx(float(first[far]) * 0.95**10, rel=1e-4)
    assert last.median() > first.median()


def test_who_decays() -> None:
    config = preset("draft")
    tuned = tuned_baseline(config)
    assert tuned.coarse is not None
    assert tuned.coarse.get(OpacityDecay) == config.scene.of(OpacityDecay)
    assert tuned.fine.of(OpacityDecay).share == config.roi.of(OpacityDecay).share
    for other in (baseline(config), preset("paper").roi, block_stage(config.roi, 0.5, 0.5)):
        assert other.get(OpacityDecay) is None
