"""Validation photos: settings are chosen on them, and nothing uses the test photos meanwhile."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.context import Context
from roigs_engine.errors import ConfigError, RunFolderError, SceneError
from roigs_engine.formats.events import Event, Message
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.run.definition import Run, define_run
from roigs_engine.run.dry_run import describe_plan
from roigs_engine.run.strategies import plan_run
from roigs_engine.selection.split import choose_test_views
from tests.engine.commands.command_line import BOX as BOX_OPTION
from tests.engine.runs import opened, tiny
from tests.engine.synthetic_colmap import write_project
from tests.engine.synthetic_scene import BOX, make_scene

SECOND = OrientedBox.between("second", [-0.2, -0.2, -0.2], [0.5, 0.5, 0.5])
COMPARED = ("full-scene", "full-object", "independent")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"), views=16)


def runs(scene: SfmScene, folder: Path, *boxes: OrientedBox) -> tuple[Run, Run]:
    """The run of test photos, and that of validation photos."""
    first, second = (
        define_run(folder, scene, boxes or [BOX], tiny("joint", evaluate_on=photos))
        for photos in ("test", "validation")
    )
    return first, second


def test_both_sets_are_disjoint_and_chosen_alike(scene: SfmScene, tmp_path: Path) -> None:
    tested, validated = runs(scene, tmp_path, BOX, SECOND)
    assert validated.test == tested.test and tested.validation == ()
    assert (tested.measured, validated.measured) == (tested.test, validated.validation)
    rest = validated.scene.without(set(validated.test))
    assert validated.validation == choose_test_views(rest, validated.rois, 4)
    sets = [
        set(validated.test),
        set(validated.validation),
        {image.name for image in validated.train_scene.images},
    ]
    assert all(sets) and sum(map(len, sets)) == len(set.union(*sets)) == len(scene.images)


def test_no_stage_has_a_photo_that_is_held_out(scene: SfmScene, tmp_path: Path) -> None:
    _, validated = runs(scene, tmp_path)
    plan = plan_run(validated, COMPARED)
    held_out = {*validated.test, *validated.validation}
    for stage in plan.stages:
        assert not {image.name for image in stage.images} & held_out
    for chosen in (chosen for group in plan.selections.values() for chosen in group):
        assert not {*chosen.names, *chosen.candidates} & held_out


def test_everything_but_the_photos_is_unchanged(scene: SfmScene, tmp_path: Path) -> None:
    tested, validated = (plan_run(run, COMPARED).stages for run in runs(scene, tmp_path))
    assert [stage.name for stage in tested] == [stage.name for stage in validated]
    for one, other in zip(tested, validated, strict=True):
        # The SH learning rate follows from how close together the training photos are.
        same = replace(one.config, lr_shN=other.config.lr_shN)
        assert same.to_dict() == other.config.to_dict()  # without what the photos decide
        assert one.seed == other.seed
        assert one.fingerprint != other.fingerprint


def test_a_folder_of_one_is_refused_for_the_other(scene: SfmScene, tmp_path: Path) -> None:
    opened(tmp_path, scene, [BOX], tiny("joint"))
    assert json.loads((tmp_path / "split.json").read_text("utf-8"))["evaluate_on"] == "test"
    other = tiny("joint", evaluate_on="validation")
    with pytest.raises(RunFolderError, match="evaluate_on was test, now validation"):
        opened(tmp_path, scene, [BOX], other)
    run = opened(tmp_path, scene, [BOX], other, update=True)
    assert json.loads((tmp_path / "split.json").read_text("utf-8")) == {
        "evaluate_on": "validation",
        "test": list(run.test),
        "validation": list(run.validation),
    }


def test_the_plan_says_what_is_unused(scene: SfmScene, tmp_path: Path) -> None:
    _, run = runs(scene, tmp_path / "run")
    counts = len(run.train_scene.images), len(run.validation), len(run.test)
    said = "{} to train on, {} to validate on, {} test photos unused".format(*counts)
    assert said in describe_plan(run)


def test_manual_photos_that_are_held_out_are_left_out(scene: SfmScene, tmp_path: Path) -> None:
    _, run = runs(scene, tmp_path)
    chosen = [run.test[0], run.validation[0], run.train_scene.images[0].name]
    events: list[Event] = []
    again = define_run(
        tmp_path,
        scene,
        [BOX],
        run.config,
        manual={"thing": chosen},
        context=Context(emit=events.append),
    )
    assert again.manual["thing"] == (chosen[2],)
    (text,) = [event.text for event in events if isinstance(event, Message)]
    assert text.startswith("Skipped 2 selected photos of box 'thing', held out")


def test_too_few_photos_for_both(tmp_path: Path) -> None:
    few = make_scene(tmp_path, views=2)
    define_run(tmp_path, few, [BOX], tiny("joint"))
    with pytest.raises(SceneError, match="No validation photos"):
        define_run(tmp_path, few, [BOX], tiny("joint", evaluate_on="validation"))
    with pytest.raises(ConfigError, match="no validation photos"):
        tiny("joint", evaluate_on="validation", test_every=0)


def test_reports_say_validation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run, and `evaluate` on its split."""
    project = write_project(
        tmp_path / "scene", names=[f"{k}.png" for k in range(12)], dots=True
    ).folder
    given = [str(project), "--roi", BOX_OPTION, "--device", "cpu"]
    tiny_run = ["--steps-factor", "0.003", "--test-every", "4", "--compare"]
    out = tmp_path / "run"
    options = [*tiny_run, "--evaluate-on", "validation", "--run-dir", str(out)]
    assert main(["run", *given, *options]) == 0
    assert "# Evaluation on 2 validation photos" in capsys.readouterr().out
    split = json.loads((out / "split.json").read_text("utf-8"))
    report = json.loads((out / "report.json").read_text("utf-8"))
    assert report["photos"] == "validation"
    assert report["test_views"] == split["validation"]
    told = "".join(p.read_text("utf-8") for p in (out / "report.md", out / "report.json"))
    assert not any(f'"{name}"' in told or f" {name}" in told for name in split["test"])
    again = tmp_path / "again"
    models = ["--model", f"Ours={out / 'result.ply'}", "--split", str(out / "split.json")]
    assert main(["evaluate", *given, *models, "--out", str(again)]) == 0
    assert (
        json.loads((again / "report.json").read_text("utf-8"))["test_views"] == split["validation"]
    )
    (out / "split.json").write_text('{"evaluate_on": "both", "test": ["a"]}', encoding="utf-8")
    assert main(["evaluate", *given, *models, "--out", str(again)]) == 2
    assert "neither test nor validation" in capsys.readouterr().err
