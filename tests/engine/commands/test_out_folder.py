"""`--out` into a run folder: not while an engine is at work there."""

from __future__ import annotations

from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.commands.out_folder import claimed
from roigs_engine.errors import RunFolderError
from roigs_engine.formats.lock import locked
from tests.addon.colmap_project import write_project

BOX = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
OWN = (
    *("", "selection", "result.ply", "Crops", "scene", "object-a b/x", "cache/undistorted"),
    *("compare-joint/result.ply", "full-object-vase", "archive/results-1234"),
)
FREE = ("renders", "evaluation/crops", "mine.ply", "nest/renders")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / "run").mkdir()
    for name in ("manifest.json", "split.json"):
        (tmp_path / "run" / name).write_text("{}")
    return tmp_path / "run"


@pytest.mark.parametrize("name", OWN)
def test_what_a_run_in_use_writes_is_refused(run: Path, name: str) -> None:
    with locked(run):
        refused = pytest.raises(RunFolderError, match="Another engine")
        with refused as caught, claimed(run / name):
            pass
        assert "--out" in caught.value.hint
        assert (run / "run.lock").exists()
    with claimed(run / name):
        assert (run / "run.lock").exists()
    assert not (run / "run.lock").exists()


@pytest.mark.parametrize("name", FREE)
def test_other_places_in_a_run_folder_are_free(run: Path, name: str) -> None:
    with locked(run), claimed(run / name):
        pass
    with claimed(run / name):
        assert not (run / "run.lock").exists()


def test_a_run_within_the_files_of_another(run: Path) -> None:
    with locked(run):
        refused = pytest.raises(RunFolderError, match="--run-dir")
        with refused, claimed(run / "compare-joint", option="--run-dir"):
            pass
        with claimed(run / "nest", option="--run-dir"), locked(run / "nest"):
            pass
    with claimed(run, option="--run-dir"), locked(run):
        pass


def test_a_loop_of_links_is_no_run_folder(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with claimed(tmp_path / "loop" / "a"):
        pass


def test_a_folder_that_is_no_run_gets_no_lock(tmp_path: Path) -> None:
    with claimed(tmp_path / "scene"), claimed(None):
        assert not list(tmp_path.iterdir())


def test_the_commands_refuse_in_one_line(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = str(write_project(tmp_path / "scene"))
    select = ["select", scene, "--roi", BOX, "--out"]
    compose = ["compose", "a.ply", "--roi", BOX, "--object", "thing=b.ply"]
    for command in (
        [*select, str(run / "selection")],
        ["export", scene, "--out", str(run)],
        [*compose, "--out", str(run / "result.ply")],
        ["evaluate", scene, "--roi", BOX, "--model", "A=a.ply", "--out", str(run)],
        ["render", "a.ply", "--scene", scene, "--out", str(run / "crops" / "thing")],
    ):
        with locked(run):
            assert main(command) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "Another engine is at work" in line
    with locked(run):
        assert main([*select, str(run / "chosen")]) == 0
    assert main([*select, str(run / "selection")]) == 0
    assert (run / "selection" / "thing.json").exists()
