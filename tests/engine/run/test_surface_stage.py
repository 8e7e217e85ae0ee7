"""The stage that makes a result a surface."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch

from roigs_engine.model.scene import SfmScene
from roigs_engine.run.definition import define_run
from roigs_engine.run.folder import train_surface
from roigs_engine.run.strategies import plan_surface
from roigs_engine.training.mechanisms.masked_steps import MaskedSteps
from roigs_engine.training.mechanisms.surface_losses import SurfaceLosses
from tests.engine.runs import SECOND, plys, production, stage_of, train
from tests.engine.synthetic_scene import BOX, make_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_it_follows_the_result_and_changes_no_file_of_it(
    scene: SfmScene, tmp_path: Path, strategy: str
) -> None:
    config = production(strategy)
    train(tmp_path, scene, [BOX, SECOND], config)
    before = plys(tmp_path)
    run = define_run(tmp_path, scene, [BOX, SECOND], config)
    made = train_surface(run)
    assert made is not None
    folder = stage_of(tmp_path, "surface")
    after = plys(tmp_path)
    assert set(after) - set(before) == {str((folder / "model.ply").relative_to(tmp_path))}
    assert {name: after[name] for name in before} == before
    again = train_surface(run)
    assert again is not None and plys(tmp_path) == after
    for one, other in zip(made.tensors().values(), again.tensors().values(), strict=True):
        assert torch.equal(one, other)
    train(tmp_path, scene, [BOX, SECOND], config)  # the run is still the same
    assert plys(tmp_path) == after


def test_without_the_stages_of_the_result_there_is_none(scene: SfmScene, tmp_path: Path) -> None:
    config = production()
    train(tmp_path, scene, [BOX], config)
    shutil.rmtree(stage_of(tmp_path, "joint"))
    assert train_surface(define_run(tmp_path, scene, [BOX], config)) is None


def test_its_steps_are_on_masks(scene: SfmScene, tmp_path: Path) -> None:
    config = production("independent")
    stage = plan_surface(define_run(tmp_path, scene, [BOX], config)).stages[-1]
    assert stage.name == "surface" and stage.config.get(SurfaceLosses)
    assert stage.config.of(MaskedSteps).whole_share == 0
    assert stage.config.steps < config.roi.steps
