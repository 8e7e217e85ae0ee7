"""Events of an engine run: frozen dataclasses, one JSON line each.

The command line shows them as a progress bar or, with `--events`, as JSON lines on standard output.
The Blender add-on reads these lines. Nothing below the command line prints.
"""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from typing import Any

from .text import CONTROLS


@dataclass(frozen=True, kw_only=True)
class StageStarted:
    """A stage of the pipeline begins (`total` steps; 0 when it has no steps)."""

    stage: str
    total: int = 0


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of a stage. Seconds are wall-clock; `psnr` is over recent photos, in dB.

    `loss` is NaN in a stage that has none (evaluation), and `null` in JSON. `run_seconds_left`
    includes all later stages; NaN if it is unknown.
    """

    stage: str
    step: int
    total: int
    loss: float
    psnr: float
    gaussians: int
    seconds_left: float
    run_seconds_left: float = math.nan


@dataclass(frozen=True, kw_only=True)
class Message:
    """Something a person should know: level is 'info', 'warning', or 'detail', for logs."""

    text: str
    level: str = "info"


@dataclass(frozen=True, kw_only=True)
class Device:
    """The device that draws and trains, and why; one event for each command that uses it."""

    kind: str  # "cpu", "cuda" or "gpu"
    name: str  # name of the GPU; empty for the CPU
    reason: str  # "checked", "not checked", "chosen", or why a GPU is not used, without full stop


@dataclass(frozen=True, kw_only=True)
class Preview:
    """A picture or model of the run's present state has been written."""

    path: str


@dataclass(frozen=True, kw_only=True)
class Done:
    """The command ended well (`stopped`: on request; it can be resumed)."""

    outputs: dict[str, str]
    stopped: bool = False


@dataclass(frozen=True, kw_only=True)
class Failed:
    """The command ended in an `EngineError`."""

    message: str
    hint: str = ""


@dataclass(frozen=True, kw_only=True)
class Board:
    """The progress of a batch, as lines for a terminal; not written as JSON."""

    lines: tuple[str, ...]


Event = StageStarted | Progress | Message | Device | Preview | Done | Failed | Board
Record = dict[str, Any]
"""An event from a file: its name as `event`, and the fields that are present."""

_KINDS = {"str": str, "int": int, "float": float, "bool": bool, "dict[str, str]": dict}
FIELDS: dict[str, dict[str, type]] = {
    kind.__name__.lower(): {f.name: _KINDS[str(f.type)] for f in dataclasses.fields(kind)}
    for kind in (StageStarted, Progress, Message, Device, Preview, Done, Failed)
}
"""The fields of each event, by its name in JSON; readers ignore anything else on a line."""
FINAL = ("done", "failed")
CPU_NAME = "the processor"
MAX_NUMBER = 1 << 31  # limit of Blender's integers
MAX_LINE = 1 << 16  # characters; a longer line is not an event


def to_json(event: Event) -> str:
    """One line of JSON, its `event` key the class's name in lower case (`stagestarted`, …).

    Numbers that JSON does not have (a PSNR before the first one is measured) become null.
    """
    record: dict[str, Any] = {"event": type(event).__name__.lower()}
    for key, value in dataclasses.asdict(event).items():
        missing = isinstance(value, float) and not math.isfinite(value)
        record[key] = None if missing else value
    line = json.dumps(record, ensure_ascii=False, allow_nan=False)
    # JSON allows other control characters, but some readers end a line there, and terminals obey
    # them.
    line = CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", line)
    # A file name that is not UTF-8 contains surrogates, which streams cannot write.
    return line.encode("utf-8", "backslashreplace").decode("utf-8")


def parse_event(line: str) -> Record | None:
    """The event on a line, or None if the line is not an event.

    Any program may have written the line. The record has only fields of the right type, with finite
    numbers, printable text, and paths as they are.
    """
    if len(line) > MAX_LINE:
        return None
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    name = record.get("event") if isinstance(record, dict) else None
    if not isinstance(name, str) or name not in FIELDS:
        return None
    event = {"event": name}
    for key, kind in FIELDS[name].items():
        value = _typed(record.get(key), kind)
        if isinstance(value, str) and key != "path":  # Blender's properties accept only UTF-8
            value = "".join(c if c.isprintable() else " " for c in value)
        if value is not None:
            event[key] = value
    return event


def device_in_words(event: Record) -> str:
    """'NVIDIA RTX 4070 (checked)', or 'the processor (why)'."""
    name = event.get("name") if event.get("kind") != "cpu" else ""
    reason = event.get("reason")
    return f"{name or CPU_NAME}{f' ({reason})' if reason else ''}"


def _typed(value: Any, kind: type) -> Any:
    if kind is dict and isinstance(value, dict):
        return {key: path for key, path in value.items() if isinstance(path, str)}
    if kind in (int, float):
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        # The comparison is exact for integers of any size, and False for NaN.
        return kind(value) if number and abs(value) < MAX_NUMBER else None
    return value if isinstance(value, kind) else None
