"""Whether the engine can train here; a thread asks, because it takes up to seconds."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from .. import settings
from ..engine import python
from ..windows import Timer, redraw_sidebars

RECHECK_SECONDS = 5.0
"""How long an engine that lacks something is assumed to lack it."""


class EngineCheck:
    """Asks the engine's Python what it has.

    Attributes:
        problem: why it cannot train; empty if it can, or as long as that is not known.
        thread: the one that asks; None before the first question.
    """

    def __init__(self) -> None:
        """Nothing is known yet."""
        self.problem = ""
        self.thread: threading.Thread | None = None
        self._asked: tuple[str, tuple[Path, ...]] | None = None
        self._at = 0.0

    def ask(self) -> str:
        """The problem as far as it is known; asks again if the settings have changed."""
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
        """Ask again next time: what was there may be gone."""
        self._asked = None

    def busy(self) -> bool:
        """Whether an answer is on its way."""
        return self.thread is not None and self.thread.is_alive()

    def _look(self, chosen: str, environments: tuple[Path, ...]) -> None:
        if self.problem:  # what was missing may have been installed since
            python.ability.cache_clear()
        _, self.problem = python.find(chosen, environments, python.FOR_TRAINING)
        self._at = time.monotonic()


_check = EngineCheck()


def problem() -> str:
    """Why the engine cannot train, as far as that is known."""
    return _check.ask()


def forget() -> None:
    """Ask again; an environment was removed."""
    _check.forget()


def _poll() -> bool:
    if _check.busy():
        return True
    redraw_sidebars()
    return False


timer = Timer(_poll, 0.2)
