"""`run` and `train` in this process: a plan, a run, and the run again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.formats import run_files
from roigs_engine.formats.levels import read_ladders
from tests.engine.commands.command_line import BOX
from tests.engine.synthetic_colmap import Project, write_project


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Project:
    names = [f"{k}.png" for k in range(10)]
    return write_project(tmp_path_factory.mktemp("run") / "a scene", names=names, dots=True)


def arguments(project: Project, run: Path, *more: str) -> list[str]:
    tiny = ["--steps-factor", "0.003", "--test-every", "4", "--device", "cpu"]
    return [str(project.folder), "--roi", BOX, *tiny, "--run-dir", str(run), *more]


@pytest.mark.parametrize("command", ["train", "run"])
def test_a_dry_run_leaves_no_trace(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    run = tmp_path / "run"
    assert main([command, *arguments(project, run, "--dry-run")]) == 0
    shown = capsys.readouterr().out
    stages = ["scene", "joint"] if command == "train" else ["scene", "joint", "full-scene"]
    lines = [line.split() for line in shown.splitlines()]
    begin = next(row for row, words in enumerate(lines) if words[:2] == ["stage", "photos"]) + 1
    assert [words[0] for words in lines[begin : begin + len(stages)]] == stages
    assert "on this machine" in shown
    assert not run.exists()


def test_a_run_its_record_and_the_run_again(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *arguments(project, tmp_path, "--preview-seconds", "1e-6")]) == 0
    shown = capsys.readouterr()
    assert "ROI PSNR" in shown.out
    assert "earlier training" not in shown.err
    assert not (tmp_path / run_files.PREVIEW).exists()
    result = (tmp_path / run_files.RESULT).read_bytes()
    assert main(["run", *arguments(project, tmp_path)]) == 0
    said = capsys.readouterr().err
    assert all(
        f"{stage}: finished in an earlier training" in said
        for stage in ("full-scene", "scene", "joint")
    )
    assert (tmp_path / run_files.RESULT).read_bytes() == result
    assert main(["run", *arguments(project, tmp_path, "--dry-run")]) == 0
    assert capsys.readouterr().out.count(" done\n") == 3
    entries = json.loads((tmp_path / run_files.PROVENANCE).read_text(encoding="utf-8"))["entries"]
    assert [entry["ended"] for entry in entries] == ["done", "done"]
    assert set(entries[0]["stages"]) == {"full-scene", "scene", "joint"}
    assert entries[0]["device"] == "cpu" and entries[0]["seed"] == 0
    assert not (tmp_path / run_files.LOCK).exists()


def test_other_settings_are_refused_in_one_line(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", *arguments(project, tmp_path)]) == 0
    capsys.readouterr()
    assert main(["train", *arguments(project, tmp_path, "--seed", "1")]) == 2
    error = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]
    assert len(error) == 1 and "seed was 0, now 1" in error[0] and "--update" in error[0]


def test_numbers_that_no_run_can_have(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ("--preview-seconds", "--image-cache"):
        assert main(["train", *arguments(project, tmp_path / "run", option, "-1")]) == 2
        assert option in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_levels_of_detail_at_the_end(project: Project, tmp_path: Path) -> None:
    assert main(["train", *arguments(project, tmp_path, "--levels", "2")]) == 0
    assert "" in read_ladders(tmp_path)
