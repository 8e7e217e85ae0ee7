"""Finds the training device and the reason for it, in the engine's words."""

from __future__ import annotations

import re
import sys
import threading
from pathlib import Path

import bpy

from .. import settings
from ..engine import device_check, own_files, python
from ..engine.event_log import DEVICE
from ..errors import AddonError
from ..jobs import current, run_folders
from ..jobs.last_said import last_said
from ..shared import events
from ..windows import Timer, redraw, redraw_sidebars

_SAID = re.compile(r"\d\d:\d\d:\d\d  " + re.escape(DEVICE) + "(.+)")

WITHOUT_CUDA = f"{events.CPU_NAME} (This torch is built without CUDA"
"""Beginning of the engine's answer if **Set Up the Engine** could install torch with CUDA."""

_logs: dict[Path, tuple[tuple[int, int], str]] = {}


class DeviceCheck:
    """Asks the engine for its device in a thread: the first use of a GPU may take a minute.

    Attributes:
        answer: of the engine; empty if it was not asked, or could not answer.
        device: of the preferences when the engine was asked.
        thread: waits for the answer; None before the first question.
    """

    def __init__(self) -> None:
        """Start without an answer."""
        self.answer = self.device = ""
        self.thread: threading.Thread | None = None

    def ask(self) -> None:
        """Start to ask, unless this is under way."""
        if self.busy():
            return
        self.device = settings.get().device
        question = settings.chosen_python(), settings.environments()
        self.thread = threading.Thread(target=self._look, args=question, daemon=True)
        self.thread.start()

    def busy(self) -> bool:
        """Whether the engine has not answered yet."""
        return self.thread is not None and self.thread.is_alive()

    def _look(self, chosen: str, environments: tuple[Path, ...]) -> None:
        engine, _ = python.find(chosen, environments, python.FOR_TRAINING)
        self.answer = "" if engine is None else device_check.ask(engine, self.device)


_check = DeviceCheck()


def ask() -> None:
    """Ask the engine; in a script, wait for the answer."""
    _check.ask()
    if not bpy.app.background:
        timer.start()
    elif _check.thread is not None:
        _check.thread.join()


def asked() -> str:
    """Return the engine's answer to `ask`; empty if another device was chosen since."""
    if _check.busy():
        return "…"
    return _check.answer if settings.get().device == _check.device else ""


def in_words(device: str) -> str:
    """Describe a device: 'Trains on NVIDIA RTX 4070 (checked)'; with advice if torch lacks CUDA."""
    if device.startswith(device_check.FAILED):
        return device
    if device.startswith(WITHOUT_CUDA):
        hint = "" if sys.platform == "darwin" else " For an NVIDIA card: Set Up the Engine"
        return f"{DEVICE}{events.CPU_NAME}.{hint}"
    return f"{DEVICE}{device}"


def of_run(scene: bpy.types.Scene) -> str:
    """Return the device of the running or the last training here; otherwise `asked`."""
    if said := current.device():
        return said
    log = own_files.log_file(run_folders.run_folder(scene))
    return _in_log(log) or ("" if _check.busy() else asked())


def _in_log(log: Path) -> str:
    """Return the device in the log, which is read again when it has changed."""
    try:
        state = log.stat()
        key = state.st_mtime_ns, state.st_size
        if log not in _logs or _logs[log][0] != key:
            _logs.clear()
            _logs[log] = key, last_said(log, _SAID)
    except (OSError, AddonError):
        return ""
    return _logs[log][1]


def forget() -> None:
    """Forget the answer: the engine may have changed."""
    _check.answer = ""


def _poll() -> bool:
    if _check.busy():
        return True
    redraw("PREFERENCES")
    redraw_sidebars()
    return False


timer = Timer(_poll, 0.3, persistent=True)
