"""`--blocks` and `--group`: on the command line, in an options file, in a batch."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from roigs_engine.app.batch_plan import plan_row
from roigs_engine.app.batch_table import Table
from roigs_engine.batch.record import BatchRecord
from roigs_engine.cli import main
from roigs_engine.context import QUIET
from roigs_engine.formats import run_files
from roigs_engine.run import definition
from tests.engine.commands.command_line import BOX, refused
from tests.engine.runs import finished
from tests.engine.synthetic_colmap import Project, write_project

TWO = ("--roi", BOX, "--roi", "other=-0.9,-0.9,-0.9,0.2,0.2,0.2")


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Project:
    names = [f"{k}.png" for k in range(12)]
    return write_project(tmp_path_factory.mktemp("run") / "a scene", names=names, dots=True)


@pytest.fixture(autouse=True)
def few_photos_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(definition, "FEWEST", 2)


def arguments(project: Project, run: Path, *more: object) -> list[str]:
    tiny = ["--steps-factor", "0.003", "--test-every", "4", "--device", "cpu"]
    return [str(project.folder), *TWO, *tiny, "--run-dir", str(run), *map(str, more)]


def test_a_run_in_blocks_and_the_run_again(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = arguments(project, tmp_path, "--blocks", 2, "--compare")
    assert main(["run", *options]) == 0
    said = capsys.readouterr().err
    assert "Blocks save little here" in said  # a ring around the boxes
    result = (tmp_path / run_files.RESULT).read_bytes()
    (tmp_path / run_files.RESULT).unlink()
    assert main(["run", str(tmp_path / run_files.SETTINGS), "--run-dir", str(tmp_path)]) == 0
    assert "block-2-joint: finished in an earlier training" in capsys.readouterr().err
    assert (tmp_path / run_files.RESULT).read_bytes() == result


def test_what_auto_has_chosen_stays(
    project: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    auto = arguments(project, tmp_path, "--blocks", "auto")
    monkeypatch.setattr(definition, "USELESS", 1.0)
    with monkeypatch.context() as small:
        small.setattr(definition, "_needed", lambda scene, layout, *_: 2 - bool(layout.blocks))
        small.setattr(definition, "machine_memory", lambda: 1)
        assert main(["train", *auto]) == 0
    assert {"block-1-scene", "block-2-scene"} <= finished(tmp_path)
    assert main(["train", *auto]) == 0  # with enough memory, too
    manifest = json.loads((tmp_path / run_files.MANIFEST).read_text(encoding="utf-8"))
    assert manifest["config"]["blocks"] == 2


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--blocks", "none"], "'none' is not auto, or an integer from 1 to 64"),
        (["--blocks", "0"], "0 is not auto"),
        (["--group", "thing,lamp"], "'lamp', which is no box"),
        (["--group", "thing", "--group", "thing"], "'thing' twice"),
        (["--group", "thing", "--strategy", "independent"], "trains each box alone"),
    ],
)
def test_wrong_values_are_one_line(
    project: Project,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    problem: str,
) -> None:
    assert problem in refused(capsys, "run", *arguments(project, tmp_path / "run", *options))
    assert not (tmp_path / "run").exists()


def test_a_plan_says_what_is_wrong_before_it_chooses_the_device(
    project: Project,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("roigs_engine.app.asked.on_device", None)
    options = arguments(project, tmp_path / "run", "--dry-run", "--group", "thing,lamp")
    assert "'lamp', which is no box" in refused(capsys, "train", *options)


def test_the_plan_shows_groups(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for more, says in (
        ([], "Boxes trained together: thing, other"),
        (["--group", "other"], "Group 2: other; 9 photos"),
    ):
        assert main(["train", *arguments(project, tmp_path, "--dry-run", *more)]) == 0
        assert says in capsys.readouterr().out


def table_of(project: Project, folder: Path, *lines: str) -> Table:
    """A table of one scene with two boxes, and more lines."""
    path = folder / "table.toml"
    boxes = ", ".join(f"'{text}'" for text in TWO[1::2])
    scene = f"[scenes.hall]\nscene = '{project.folder}'\nroi = [{boxes}]\nsteps_factor = 0.003\n"
    path.write_text(scene + "\n".join(lines), encoding="utf-8")
    return Table(path, folder)


def test_a_batch_does_blocks_side_by_side(project: Project, tmp_path: Path) -> None:
    found = table_of(project, tmp_path, "blocks = 2", "group = ['thing,other']")
    assert not found.wrong
    record = BatchRecord(tmp_path)
    parts = {part.name: part for part in plan_row(found.rows[0], record, QUIET).scene.parts}
    coarse = ("block-1-scene", "block-2-scene")
    assert all(parts[name].needs == ("prepare",) for name in coarse)
    assert parts["block-1-joint"].needs == parts["block-2-joint"].needs == coarse
    for part in parts.values():  # what `auto` is here is what it is on all machines
        assert part.argv[part.argv.index("--blocks") + 1] == "2"


def test_each_part_of_a_batch_asks_for_its_own_memory(project: Project, tmp_path: Path) -> None:
    table = table_of(project, tmp_path, "strategy = 'independent'", "count = 3")
    (row,), record = table.rows, BatchRecord(tmp_path)
    parts = plan_row(row, record, QUIET).scene.parts
    memory = {part.name: part.memory for part in parts}
    assert 0 < memory["object-thing"] < memory["scene"] <= memory["all"]
