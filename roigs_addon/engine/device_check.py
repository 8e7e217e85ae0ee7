"""Asks the engine which device it would train on. No bpy."""

from __future__ import annotations

import time

from ..shared import EngineError, events
from .command import Engine
from .process import EngineProcess

SECONDS = 300.0
"""How long it may take: kernels are compiled and checked at the first use of a GPU."""


def ask(engine: Engine) -> str:
    """Which device 'auto' chooses, and why; empty if the engine does not say."""
    try:
        process = EngineProcess(engine, ["check-gpu", "--brief"])
    except (OSError, EngineError):
        return ""
    said, end = "", time.monotonic() + SECONDS
    while (running := process.running()) and time.monotonic() < end:
        time.sleep(0.05)
    if running:
        process.kill()
    for event in process.events():
        if event["event"] == "device":
            said = events.device_in_words(event)
    process.result()
    return said
