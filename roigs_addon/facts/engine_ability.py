"""Finds whether the engine can train here, in a thread, because it may take seconds."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from .. import settings
from ..engine import python
from ..windows import Timer, redraw_sidebars

RECHECK_SECONDS = 5.0
"""Seconds until an engine with a problem is checked again."""


class EngineCheck:
    """Checks the packages of the engine's Python.

    Attributes:
        problem: why it cannot train; empty if it can, or if that is not known yet.
        thread: runs the check; None before the first one.
    """

    def __init__(self) -> None:
        """Start without any result."""
        self.problem = ""
        self.thread: threading.Thread | None = None
        self._asked: tuple[str, tuple[Path, ...]] | None = None
        self._at = 0.0

    def ask(self) -> str:
        """Return the known problem; start a check if the settings have changed."""
        if self.busy():
            return self.problem
        question = settings.chosen_python(), settings.environments()
        old = self.problem and time.monotonic() - self._at > RECHECK_SECONDS
        if question != self._asked or old:
            self._asked = question
            self.thread = threading.Thread(target=self._look, args=question, daemon=True)
            self.thread.start()
            timer.start()
        return self.problem

    def forget(self) -> None:
        """Check again next time: an environment may have been removed."""
        self._asked = None

    def busy(self) -> bool:
        """Whether a check is running."""
        return self.thread is not None and self.thread.is_alive()

    def _look(self, chosen: str, environments: tuple[Path, ...]) -> None:
        if self.problem:  # missing packages may have been installed since
            python.ability.cache_clear()
        _, self.problem = python.find(chosen, environments, python.FOR_TRAINING)
        self._at = time.monotonic()


_check = EngineCheck()


def problem() -> str:
    """Return why the engine cannot train; empty if it can, or if that is not known yet."""
    return _check.ask()


def forget() -> None:
    """Check again: an environment was removed."""
    _check.forget()


def _poll() -> bool:
    if _check.busy():
        return True
    redraw_sidebars()
    return False


timer = Timer(_poll, 0.2)
