"""Asks the engine for its training device. No bpy."""

from __future__ import annotations

import time

from ..shared import EngineError, events
from .command import Engine
from .process import EngineProcess

SECONDS = 300.0
"""Time limit of the answer: the first use of a GPU compiles and checks the kernels."""


FAILED = "Cannot train: "
"""How an answer begins if a chosen device cannot be used."""


def ask(engine: Engine, device: str) -> str:
    """Return the device of a training, and the reason; empty if the engine does not answer.

    `device` is that of the preferences; for 'auto', the engine chooses.
    """
    try:
        process = EngineProcess(engine, ["check-gpu", "--brief", "--device", device])
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
    ended = process.result()
    return f"{FAILED}{ended.message}" if ended.failed and not running else said
