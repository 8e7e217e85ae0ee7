"""Events: one line of JSON each, with the class's name."""

from __future__ import annotations

import json

import pytest

from roigs_engine.context import QUIET
from roigs_engine.errors import ConfigError, EngineError, RoiError
from roigs_engine.formats.events import (
    Done,
    Event,
    Failed,
    Message,
    Preview,
    Progress,
    StageStarted,
    to_json,
)

EVENTS: list[Event] = [
    StageStarted(stage="scene", total=3),
    Progress(
        stage="s",
        step=1,
        total=3,
        loss=0.1,
        psnr=20.0,
        gaussians=5,
        seconds_left=1.5,
        run_seconds_left=9.0,
    ),
    Message(text="zdjęcie\nz dwóch linii", level="warning"),
    Preview(path="a b/ć.png"),
    Done(outputs={"report": "report.md"}, stopped=True),
    Failed(message="no", hint="yes"),
]


@pytest.mark.parametrize("event", EVENTS, ids=lambda event: type(event).__name__)
def test_one_line_that_reads_back(event: Event) -> None:
    line = to_json(event)
    assert "\n" not in line
    record = json.loads(line)
    assert record.pop("event") == type(event).__name__.lower()
    assert type(event)(**record) == event
    QUIET.emit(event)


def test_errors_are_one_line_with_their_hint() -> None:
    error = RoiError("two\nlines", "and a\nhint")
    assert str(error) == "two lines and a hint"
    assert (error.message, error.hint) == ("two lines", "and a hint")
    assert str(ConfigError("alone")) == "alone"
    assert isinstance(error, EngineError)


def test_paths_that_are_no_utf8() -> None:
    line = to_json(Preview(path="caf\udce9.ply"))
    assert json.loads(line.encode("utf-8"))["path"] == "caf\udce9.ply"
