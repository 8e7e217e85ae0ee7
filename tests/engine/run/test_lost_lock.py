"""Runs whose lock is deleted while they work, or whose file system has no locks."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.context import Context
from roigs_engine.errors import RunFolderError
from roigs_engine.formats.events import Event, StageStarted
from roigs_engine.formats.lock import locked
from roigs_engine.run import stage_folder
from roigs_engine.run.provenance import recorded
from tests.addon.colmap_project import write_project
from tests.engine.runs import plys, tiny, train
from tests.engine.synthetic_scene import BOX, make_scene

pytestmark = pytest.mark.skipif(os.name != "posix", reason="Windows does not delete what is open")


@pytest.mark.parametrize("seconds", [0.0, 60.0], ids=["at a checkpoint", "at the end of a stage"])
def test_an_engine_that_lost_its_lock_writes_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seconds: float
) -> None:
    monkeypatch.setattr(stage_folder, "CHECKPOINT_SECONDS", seconds)
    (tmp_path / "photos").mkdir()
    scene, run = make_scene(tmp_path / "photos"), tmp_path / "run"
    before: dict[Path, bytes] = {}

    def contents() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}

    def lose(event: Event) -> None:
        if isinstance(event, StageStarted) and event.stage == "joint":
            (run / "run.lock").unlink()
            before.update(contents())

    with pytest.raises(RunFolderError, match="deleted or replaced"), locked(run):  # noqa: SIM117
        with recorded(run, 0, "cpu"):
            train(run, scene, [BOX], tiny("joint"), context=Context(emit=lose))
    assert before and contents() == before
    train(run, scene, [BOX], tiny("joint"))
    train(tmp_path / "whole", scene, [BOX], tiny("joint"))
    assert plys(run) == plys(tmp_path / "whole")


def test_a_run_on_a_file_system_without_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    scene = write_project(tmp_path / "scene")
    box = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
    command = ["train", str(scene), "--roi", box, "--max-side", "24", "--steps-factor", "0.001"]
    assert main([*command, "--run-dir", str(tmp_path / "usual")]) == 0
    capsys.readouterr()
    monkeypatch.setattr("fcntl.flock", refuse)
    for run in (tmp_path / "run", tmp_path / "run"):
        assert main([*command, "--run-dir", str(run)]) == 0
        assert capsys.readouterr().err.count("has no locks") == 1
        assert plys(run) == plys(tmp_path / "usual") and not (run / "run.lock").exists()
