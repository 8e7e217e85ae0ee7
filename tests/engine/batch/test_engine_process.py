"""An engine process of a batch: its events, a stop, and how it ended."""

from __future__ import annotations

import gc
import signal
import sys
from pathlib import Path

import pytest

from roigs_engine.batch import engine_process
from roigs_engine.batch.engine_process import DONE, FAILED, LOST, STOPPED, Outcome, run_engine
from roigs_engine.formats.events import Record


def ended(argv: list[str], stop: bool = False) -> tuple[Outcome, list[Record]]:
    events: list[Record] = []
    return run_engine(argv, events.append, lambda: stop), events


def fake(monkeypatch: pytest.MonkeyPatch, folder: Path, code: str) -> None:
    """Have `python -m roigs_engine` be this program."""
    package = folder / "roigs_engine"
    package.mkdir()
    (package / "__main__.py").write_text(code, encoding="utf-8")
    (package / "__init__.py").touch()
    environment = engine_process.child_environment() | {"PYTHONPATH": str(folder)}
    monkeypatch.setattr(engine_process, "child_environment", lambda: environment)
    monkeypatch.chdir(folder)


def test_an_error_is_its_one_line(tmp_path: Path) -> None:
    outcome, events = ended(["inspect", str(tmp_path / "none")])
    assert outcome.state == FAILED and "none" in outcome.reason and not events


def test_a_process_that_is_killed_or_crashes_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = f"import os\nos.kill(os.getpid(), {int(signal.SIGKILL)})"
    fake(monkeypatch, tmp_path, code)
    assert ended([])[0] == Outcome(
        state=LOST, reason="The engine was ended by signal 9 (is the memory full?)."
    )
    (tmp_path / "roigs_engine" / "__main__.py").write_text("import nothing_of_that_name")
    outcome, _ = ended([])
    assert outcome.state == LOST and "status 1. ModuleNotFoundError" in outcome.reason


def test_events_and_a_stop_go_through(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = (
        'print(\'{"event": "message", "text": "here"}\', flush=True)\n'
        "assert input() == 'stop'\n"
        "print('not an event')\n"
        'print(\'{"event": "done", "outputs": {}, "stopped": true}\')\n'
    )
    fake(monkeypatch, tmp_path, code)
    outcome, events = ended([], stop=True)
    assert outcome.state == STOPPED
    assert [event["text"] for event in events] == ["here"]
    (tmp_path / "roigs_engine" / "__main__.py").write_text(
        'print(\'{"event": "done", "outputs": {}}\')'
    )
    assert ended([])[0].state == DONE


@pytest.mark.filterwarnings("error")  # as PYTHONWARNINGS=error: Python then prints a traceback
def test_no_pipe_is_left_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(monkeypatch, tmp_path, 'print(\'{"event": "done", "outputs": {}}\')')
    lost: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    assert ended([])[0].state == DONE
    gc.collect()
    assert not lost
