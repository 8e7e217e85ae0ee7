"""Events an engine run emits: plain frozen dataclasses, one JSON line each.

The command line turns them into a progress bar or, with `--events`, into JSON lines on standard
output, which is what the Blender add-on reads. Nothing below the command line prints.
"""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class StageStarted:
    """A stage of the pipeline begins (`total` steps; 0 when it has no steps)."""

    stage: str
    total: int = 0


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where a stage is. Seconds are wall-clock; `psnr` is over recent photos, in dB.

    `loss` is NaN in a stage that has none (evaluation), and `null` in JSON.
    """

    stage: str
    step: int
    total: int
    loss: float
    psnr: float
    gaussians: int
    seconds_left: float


@dataclass(frozen=True, kw_only=True)
class Message:
    """Something a person should know: level is 'info' or 'warning'."""

    text: str
    level: str = "info"


@dataclass(frozen=True, kw_only=True)
class Preview:
    """A picture or model of the run's present state has been written."""

    path: str


@dataclass(frozen=True, kw_only=True)
class Done:
    """The command ended well (`stopped`: on request, and can be continued)."""

    outputs: dict[str, str]
    stopped: bool = False


@dataclass(frozen=True, kw_only=True)
class Failed:
    """The command ended in an `EngineError`."""

    message: str
    hint: str = ""


Event = StageStarted | Progress | Message | Preview | Done | Failed


def to_json(event: Event) -> str:
    """One line of JSON, its `event` key the class's name in lower case (`stagestarted`, …).

    Numbers that JSON does not have (a PSNR before the first one is measured) become null.
    """
    record: dict[str, Any] = {"event": type(event).__name__.lower()}
    for key, value in dataclasses.asdict(event).items():
        missing = isinstance(value, float) and not math.isfinite(value)
        record[key] = None if missing else value
    line = json.dumps(record, ensure_ascii=False, allow_nan=False)
    # A file name that is no UTF-8 comes with surrogates, which no stream could write.
    return line.encode("utf-8", "backslashreplace").decode("utf-8")
