"""Limits on the Gaussians of a box: what the photos show of it, and the schedule."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from roigs_engine.model.scene import SfmScene
from roigs_engine.training.config import PlannedViews, TrainConfig
from roigs_engine.training.mechanisms.box_density_control import (
    EXPONENT,
    BoxDensityControl,
    RunningBoxDensityControl,
    box_budgets,
)
from roigs_engine.training.trainer import Trainer
from tests.engine.synthetic_scene import BOX, make_scene, stage_data, truth


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(Path(tmp_path_factory.mktemp("photos")), views=4)


def running(scene: SfmScene, *budgets: int) -> RunningBoxDensityControl:
    """The density control of a stage of the true model."""
    config = TrainConfig(steps=9, mechanisms=(BoxDensityControl(start=0, budgets=budgets),))
    trainer = Trainer(truth(), stage_data(scene, rois=[BOX]), config)
    made = trainer._running["box_density_control"]
    assert isinstance(made, RunningBoxDensityControl)
    return made


def test_the_limit_rises_evenly_and_ends(scene: SfmScene) -> None:
    density = running(scene, 300)
    density.began = torch.tensor([100.0])
    assert [density.limits(p) for p in (0, 0.25, 0.5, 1, 1.7)] == [
        [limit] for limit in (100, 150, 200, 300, 300)
    ]


@pytest.mark.parametrize("factor", [0.0, 2.0])
def test_the_plan_has_limits_if_they_are_set(scene: SfmScene, factor: float) -> None:
    config = TrainConfig(steps=9, mechanisms=(BoxDensityControl(budget=factor),))
    views = PlannedViews(images=scene.images, rois=[BOX], seen=lambda roi: scene.images)
    found = config.planned(views).of(BoxDensityControl).budgets
    assert found == (box_budgets(scene.images, [BOX], factor) if factor else None)


def test_the_limit_grows_with_pixels_but_more_slowly(scene: SfmScene) -> None:
    (all_photos,) = box_budgets(scene.images, [BOX], 2.0)
    (one_photo,) = box_budgets(scene.images[:1], [BOX], 2.0)
    pixels = sum(BOX.silhouette(i.camera, i.world_to_camera).sum() for i in scene.images)
    assert all_photos == pytest.approx(2.0 * pixels**EXPONENT, rel=0.02)
    assert one_photo < all_photos < 4 * one_photo


def test_it_begins_with_what_is_there_or_with_less(scene: SfmScene) -> None:
    inside = int(truth().in_box(BOX).sum())
    many, few = (box_budgets(scene.images, [BOX], factor)[0] for factor in (9.0, 0.1))
    assert running(scene, many).began.tolist() == [inside]
    assert running(scene, few).began.tolist() == [few]
    assert few < inside < many
