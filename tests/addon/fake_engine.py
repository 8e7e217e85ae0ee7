"""Stands in for the engine in tests: a package `roigs_engine` that does as the test says."""

from __future__ import annotations

import os
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from roigs_addon.engine.command import Engine
from roigs_addon.engine.process import EngineProcess, JobResult
from roigs_addon.engine.python import own_python
from roigs_engine.formats.events import Record as Event
from tests.machine_load import Waited

if TYPE_CHECKING:
    from roigs_addon.jobs.spec import JobSpec

PYTHON = Path(os.environ.get("ROIGS_TEST_PYTHON") or own_python())


def fake(folder: Path, code: str) -> Engine:
    """An engine whose `python -m roigs_engine` runs `code`; `say` prints an event."""
    package = folder / "source" / "roigs_engine"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    head = """
        import json, os, sys, time
        def say(**event):
            print(json.dumps(event), flush=True)
    """
    text = textwrap.dedent(head) + textwrap.dedent(code)
    (package / "__main__.py").write_text(text, encoding="utf-8")
    return Engine(python=PYTHON, source=folder / "source")


def until(condition: Callable[[], bool], seconds: float = 10.0) -> bool:
    """Wait for something; whether it came within that time of an idle machine."""
    waited, since = Waited(), time.monotonic()
    while not condition():
        if time.monotonic() - since > seconds and not waited.at_most(seconds):
            return False
        time.sleep(0.02)
    return True


def finished(process: EngineProcess) -> tuple[JobResult, list[Event]]:
    """The result and all events."""
    assert until(lambda: not process.running())
    return process.result(), process.events()


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not (state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z")


LISTEN = """
say(event="stagestarted", stage="scene", total=9)
line = sys.stdin.readline()
say(event="message", text="heard " + repr(line), level="info")
say(event="done", outputs={}, stopped=True)
sys.exit(3)
"""


def in_edit_mode(item: Any, spec: JobSpec) -> str:
    """Put an object into edit mode during a job; returns the job's outcome."""
    import bpy

    from roigs_addon import settings
    from roigs_addon.jobs import current

    job = current.start(settings.engine(()), spec)
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    assert current.wait(job).complete
    assert item.mode == "OBJECT"
    return current.outcome()


def use(monkeypatch: pytest.MonkeyPatch, folder: Path, code: str) -> None:
    """Have operators run a fake engine."""
    from roigs_addon import settings

    engine = fake(folder, code)
    monkeypatch.setattr(settings, "engine", lambda _: engine)
