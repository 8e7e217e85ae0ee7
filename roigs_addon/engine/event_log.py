"""Reads the engine's output, with lines cut at a limit, and shows events as text. No bpy."""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO

from ..shared import events

SHOWN = ("loss", "psnr", "gaussians")
DEVICE = "Trains on "
"""Beginning of the log's line about the device."""


def in_words(event: events.Record) -> str:
    """Return the event as a line of the log; empty for events shown only on the screen."""
    match event["event"]:
        case "message":
            return str(event.get("text", ""))
        case "device":
            return f"{DEVICE}{events.device_in_words(event)}"
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
    """Yield the stream's lines; of a line that is too long, only the beginning."""
    begins = True
    while part := stream.readline(events.MAX_LINE + 1):
        if begins:
            yield part
        begins = part.endswith("\n")
