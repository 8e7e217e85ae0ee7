"""Disks that are full or may not be written to: one line, exit status 2, and nothing lost."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from roigs_engine.app.event_log import EventLog
from roigs_engine.commands.console import Console
from roigs_engine.formats.events import Message
from roigs_engine.formats.lock import locked
from tests.engine.killing import Ended, Request, engine

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the engine is forked")
FULL = "No space left on device"


def refused(ended: Ended, *words: str) -> None:
    """Exit status 2 and one line, the last, that holds these words."""
    assert ended.status == 2, ended.errors
    assert "Traceback" not in ended.errors
    *_, last = ended.errors.splitlines()
    assert last.startswith("error: ")
    for word in words:
        assert word in last


def test_a_disk_that_is_full_for_a_while(request_: Request, tmp_path: Path) -> None:
    for place in (
        "undistort: half of",
        "undistort: half of thing",
        "^scene: half of checkpoint",
        "^object-thing: half of model",
        "evaluate: half of",
    ):
        ended = engine(request_.arguments(tmp_path), request_.moment(place, "full"))
        refused(ended, FULL, str(tmp_path), "Free some space")
        assert not list(tmp_path.rglob("*.part"))
    request_.finish(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kilobytes", [16, 64, 500, 1000, 1500])
def test_a_disk_that_is_too_small(
    request_: Request, mounted: Callable[[str], Path], kilobytes: int
) -> None:
    run = mounted(f"size={kilobytes}k") / "run"
    refused(engine(request_.arguments(run)), FULL)
    mounted("size=64m")
    request_.finish(run)


def test_a_folder_that_may_not_be_written_to(
    request_: Request, mounted: Callable[[str], Path]
) -> None:
    folder = mounted("ro")
    for run in (folder, folder / "run"):
        refused(engine(request_.arguments(run)), str(run), "Read-only", "another folder")


def test_a_run_that_may_not_be_written_to_any_more(
    request_: Request, mounted: Callable[[str], Path]
) -> None:
    folder = mounted("size=64m")
    engine(request_.arguments(folder), request_.moment("^scene: step"))
    mounted("ro")
    refused(engine(request_.arguments(folder)), str(folder), "Read-only")
    mounted("rw")
    request_.finish(folder)


def test_a_folder_of_another_request(request_: Request, tmp_path: Path) -> None:
    shutil.copytree(request_.whole, tmp_path / "run")
    ended = engine([*request_.arguments(tmp_path / "run"), "--seed", 1])
    refused(ended, "seed was 0, now 1", "--update", "--run-dir")


def test_a_second_engine_in_a_folder(request_: Request, tmp_path: Path) -> None:
    with locked(tmp_path):
        ended = engine(request_.arguments(tmp_path))
        refused(ended, "Another engine", f"process {os.getpid()}", "--run-dir")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux has a device that is full")
def test_a_log_that_cannot_be_written_ends_and_nothing_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = EventLog(Console(json_lines=False).context)
    log.open(tmp_path)
    assert log._file is not None
    with open("/dev/full", "w", encoding="utf-8") as full:
        os.dup2(full.fileno(), log._file.fileno())
    for text in ("one", "two"):
        log.emit(Message(text=text))
    lines = capsys.readouterr().err.splitlines()
    assert lines[1:] == ["one", "two"] and FULL in lines[0]
