"""The engine's events, one JSON line each (docs/files.md, section Events). No bpy."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import IO, Any

Event = dict[str, Any]

FIELDS: dict[str, dict[str, type]] = {
    "stagestarted": {"stage": str, "total": int},
    "progress": {
        "stage": str,
        "step": int,
        "total": int,
        "gaussians": int,
        "loss": float,
        "psnr": float,
        "seconds_left": float,
    },
    "message": {"text": str, "level": str},
    "preview": {"path": str},
    "done": {"outputs": dict, "stopped": bool},
    "failed": {"message": str, "hint": str},
}
"""The fields that the add-on reads of each event; anything else on a line is ignored."""
FINAL = ("done", "failed")
MAX_NUMBER = 1 << 31  # Blender's integers hold less
MAX_LINE = 1 << 16  # characters; a longer line is not an event
SHOWN = ("loss", "psnr", "gaussians")


def parse_event(line: str) -> Event | None:
    """The event on a line, or None if the line is not an event that the add-on knows.

    Besides `event`, it holds those of its `FIELDS` that are present with the right type: finite
    numbers, text that Blender can show, names and paths as text.
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
        if value is not None:
            event[key] = value if key == "path" else _shown(value)
    return event


def in_words(event: Event) -> str:
    """The event as a line of the log; empty for events that belong on the screen only."""
    match event["event"]:
        case "message":
            return str(event.get("text", ""))
        case "stagestarted":
            return f"{event.get('stage')}: {event.get('total')} steps"
        case "progress":
            numbers = {name: event[name] for name in SHOWN if event.get(name)}
            shown = {n: round(v, 3) if isinstance(v, float) else v for n, v in numbers.items()}
            steps = f"{event.get('step')} of {event.get('total')}"
            return ", ".join(
                [f"{event.get('stage')}: {steps}", *(f"{n} {shown[n]}" for n in shown)]
            )
        case "done":
            return "Stopped." if event.get("stopped") else "Done."
        case "failed":
            return " ".join(str(event[part]) for part in ("message", "hint") if event.get(part))
    return ""


def read_lines(stream: IO[str]) -> Iterator[str]:
    """The stream's lines; of a line that is too long only the beginning."""
    begins = True
    while part := stream.readline(MAX_LINE + 1):
        if begins:
            yield part
        begins = part.endswith("\n")


def _typed(value: Any, kind: type) -> Any:
    """The value if it is of that kind, else None."""
    if kind is dict and isinstance(value, dict):
        return {key: path for key, path in value.items() if isinstance(path, str)}
    if kind in (int, float):
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        # The comparison is exact for integers of any size, and False for NaN.
        return kind(value) if number and abs(value) < MAX_NUMBER else None
    return value if isinstance(value, kind) else None


def _shown(value: Any) -> Any:
    """Text as a single line that Blender's properties accept: printable characters only."""
    if not isinstance(value, str):
        return value
    return "".join(c if c.isprintable() else " " for c in value)
