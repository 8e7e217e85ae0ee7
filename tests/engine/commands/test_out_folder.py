"""`--out`: not to a run's own files, and not to what a command reads."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path

import pytest

from roigs_engine.app.outputs import refuse_run_files
from roigs_engine.cli import main
from roigs_engine.errors import ConfigError
from roigs_engine.formats.lock import locked
from tests.addon.colmap_project import write_project
from tests.engine.commands.command_line import refused

BOX = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
OWN = (
    *("", "selection", "result.ply", "Crops", "stages.json", "stages/x", "cache/undistorted"),
    *("compare-joint/result.ply", "stages", "earlier/1234"),
)
FREE = ("renders", "evaluation/crops", "mine.ply", "nest/renders")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / "run").mkdir()
    for name in ("manifest.json", "split.json", "report.md"):
        (tmp_path / "run" / name).write_text("{}")
    return tmp_path / "run"


@pytest.mark.parametrize("at_work", [False, True])
@pytest.mark.parametrize("name", OWN)
def test_what_a_run_writes_is_refused(run: Path, name: str, at_work: bool) -> None:
    with locked(run) if at_work else nullcontext():
        with pytest.raises(ConfigError, match=r"--out .* would replace files") as caught:
            refuse_run_files(run / name)
        free = "other.ply" if name.endswith(".ply") else "other"
        assert f"{run / free} is free" in caught.value.hint


@pytest.mark.parametrize("name", FREE)
def test_other_places_in_a_run_folder_are_free(run: Path, name: str) -> None:
    with locked(run):
        refuse_run_files(run / name)
    refuse_run_files(run / name)


def test_a_run_within_the_files_of_another(run: Path) -> None:
    with pytest.raises(ConfigError, match="--run-dir"):
        refuse_run_files(run / "compare-joint", option="--run-dir")
    refuse_run_files(run / "nest", option="--run-dir")
    refuse_run_files(run, option="--run-dir")


def test_a_loop_of_links_is_no_run_folder(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    refuse_run_files(tmp_path / "loop" / "a")


def test_a_link_to_a_run_is_that_run(tmp_path: Path, run: Path) -> None:
    (tmp_path / "link").symlink_to(run)
    with pytest.raises(ConfigError, match=f"files of the run in {run}"):
        refuse_run_files(tmp_path / "link")


def test_the_commands_refuse_in_one_line(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = str(write_project(tmp_path / "scene"))
    before = {path: path.read_bytes() for path in run.iterdir()}
    select = ["select", scene, "--out"]
    evaluate = ["evaluate", scene, "--roi", BOX, "--model", "A=a.ply", "--out"]
    compose = ["compose", "a.ply", "--roi", BOX, "--object", "thing=b.ply"]
    train = ["--roi", BOX, "--run-dir", str(run / "stages")]
    for command in (
        [*select, str(run / "selection"), "--roi", BOX],
        [*select, str(run), "--roi", BOX.replace("thing", "manifest")],
        ["export", scene, "--out", str(run)],
        [*compose, "--out", str(run / "result.ply")],
        [*evaluate, str(run)],
        ["render", "a.ply", "--scene", scene, "--out", str(run)],
        ["render", "a.ply", "--scene", scene, "--out", str(run / "crops" / "thing")],
        ["train", scene, *train],
        ["run", scene, *train, "--dry-run"],
    ):
        for at_work in (False, True):
            with locked(run) if at_work else nullcontext():
                assert "would replace files of the run in" in refused(capsys, *command)
    with locked(run):
        assert main([*select, str(run / "chosen"), "--roi", BOX]) == 0
    assert (run / "chosen" / "thing.json").exists()
    assert {path: path.read_bytes() for path in run.iterdir() if path.is_file()} == before


def test_no_command_replaces_what_it_reads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = str(write_project(tmp_path / "scene"))
    files = ("rois", "scene", "report")
    rois, options, report = (tmp_path / f"{name}.json" for name in files)
    box = {"name": "rois", "min": [-0.5] * 3, "max": [0.5] * 3}
    for path in (rois, report):
        path.write_text(json.dumps([box]), encoding="utf-8")
    options.write_text(json.dumps({"scene": scene}), encoding="utf-8")
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    evaluate = ["evaluate", scene, "--model", "A=a.ply", "--out", tmp_path]
    for command, name in (
        (["select", scene, "--rois", rois, "--out", tmp_path], rois),
        (["export", options, "--out", tmp_path], options),
        ([*evaluate, "--rois", report], report),
        ([*evaluate, "--rois", rois, "--split", report], report),
    ):
        assert f"{name} is an input" in refused(capsys, *command)
    assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before
