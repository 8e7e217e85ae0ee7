"""Boxes in groups: far ones are trained side by side, near ones together, and all is one model."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from roigs_engine.batch.parts import cuts, needs
from roigs_engine.errors import RunFolderError
from roigs_engine.evaluation.views import EvaluatedModel
from roigs_engine.formats import run_files
from roigs_engine.formats.clean_up import removable
from roigs_engine.formats.splat_ply import read_ply
from roigs_engine.model.scene import SfmScene
from roigs_engine.run.definition import define_run
from roigs_engine.run.dry_run import describe_plan
from roigs_engine.run.strategies import plan_run
from tests.engine.runs import opened, plys, stage_of, tiny, train
from tests.engine.two_rooms import BOXES, two_rooms

TOGETHER = (("east", "west"),)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return two_rooms(tmp_path_factory.mktemp("photos"))


@pytest.fixture(scope="module")
def trained(
    scene: SfmScene, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[EvaluatedModel]]:
    folder = tmp_path_factory.mktemp("run")
    return folder, train(folder, scene, BOXES, tiny("joint"))


@pytest.fixture
def copied(trained: tuple[Path, list[EvaluatedModel]], tmp_path: Path) -> Path:
    """A copy of the run's folder."""
    return shutil.copytree(trained[0], tmp_path / "run")


def test_boxes_that_share_no_photo_are_trained_side_by_side(
    scene: SfmScene, trained: tuple[Path, list[EvaluatedModel]]
) -> None:
    folder, models = trained
    plan = plan_run(define_run(folder, scene, BOXES, tiny("joint")))
    by_name = {stage.name: stage for stage in plan.stages}
    assert list(by_name) == ["scene", "group-1-joint", "group-2-joint"]
    for stage in list(by_name.values())[1:]:
        (roi,) = stage.rois
        own = {image.name[0] == "w" for image in stage.images}
        assert own == {roi.name == "west"}  # the photos of its room alone
        assert stage.config.steps == tiny("joint").roi.steps  # a group has all steps
    parts = {chain[-1].name: needs(chain) for chain in cuts(plan)}
    assert parts == {"scene": (), "group-1-joint": ("scene",), "group-2-joint": ("scene",)}
    assert models[-1].name == "Joint"
    for number, roi in enumerate(BOXES, start=1):
        part = read_ply(folder / run_files.FINE / f"{roi.name}.ply")["means"]
        own = read_ply(stage_of(folder, f"group-{number}-joint") / run_files.MODEL)["means"]
        assert len(part) == roi.contains(own).sum() > 20


def test_a_group_of_all_is_one_stage_as_before(scene: SfmScene, tmp_path: Path) -> None:
    plan = plan_run(define_run(tmp_path, scene, BOXES, tiny("joint", groups=TOGETHER)))
    assert [stage.name for stage in plan.stages] == ["scene", "joint"]
    assert len(plan.stages[1].images) == 18


def test_another_grouping_is_another_run(scene: SfmScene, tmp_path: Path) -> None:
    opened(tmp_path, scene, BOXES, tiny("joint"))
    with pytest.raises(RunFolderError, match="groups was"):
        opened(tmp_path, scene, BOXES, tiny("joint", groups=TOGETHER))


def test_stages_of_another_grouping_stay(scene: SfmScene, copied: Path) -> None:
    made = plys(copied)
    train(copied, scene, BOXES, tiny("joint", groups=TOGETHER), update=True)
    former = {path.parent.name for path in removable(copied)}
    assert len([name for name in former if name.startswith("group-")]) == 2
    train(copied, scene, BOXES, tiny("joint"), update=True)  # and back: none is trained again
    assert {name: data for name, data in plys(copied).items() if name in made} == made
    assert {path.parent.name.partition("-")[0] for path in removable(copied)} == {"joint"}


def test_a_box_with_another_name_keeps_its_group(scene: SfmScene, copied: Path) -> None:
    before = plys(copied)
    renamed = [replace(BOXES[0], name="lamp"), BOXES[1]]
    train(copied, scene, renamed, tiny("joint"), update=True)
    after = plys(copied)
    assert after["result.ply"] == before["result.ply"]
    assert after["rois/lamp.ply"] == before["rois/east.ply"]
    assert {k: v for k, v in after.items() if "stages" in k} == {
        k: v for k, v in before.items() if "stages" in k
    }


def test_one_changed_box_trains_its_group_alone(scene: SfmScene, copied: Path) -> None:
    names = ("scene", "group-1-joint", "group-2-joint")
    before = [stage_of(copied, name) for name in names]
    smaller = [BOXES[0], BOXES[1].scaled(0.9)]
    train(copied, scene, smaller, tiny("joint"), update=True)
    after = [stage_of(copied, name) for name in names]
    assert after[:2] == before[:2] and after[2] != before[2]


def test_the_plan_lists_the_groups(scene: SfmScene, tmp_path: Path) -> None:
    text = describe_plan(define_run(tmp_path, scene, BOXES, tiny("joint")))
    assert "Group 1: east; 9 photos" in text and "Group 2: west; 9 photos" in text
    text = describe_plan(define_run(tmp_path, scene, BOXES, tiny("joint", groups=TOGETHER)))
    assert "Boxes trained together: east, west" in text


def test_the_other_strategy_has_no_groups(scene: SfmScene, tmp_path: Path) -> None:
    run = define_run(tmp_path, scene, BOXES, tiny("independent"))
    assert run.layout.cells is None and "groups" not in run.manifest()
    compared = plan_run(define_run(tmp_path, scene, BOXES, tiny("joint")), ["independent"])
    assert "compare-independent/object-east" in [stage.name for stage in compared.stages]
