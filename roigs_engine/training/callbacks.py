"""Callbacks that training calls periodically."""

from __future__ import annotations

import time
from collections.abc import Callable


class PeriodicCallback:
    """A function to call every `every` seconds of training; takes at most a tenth of the time.

    Args:
        every: seconds of training between two calls; 0: never.
        call: the function.
    """

    def __init__(self, every: float, call: Callable[[], None]) -> None:
        self._every, self._call = every, call
        self._due: float | None = None

    def call_if_due(self, seconds: float) -> float:
        """Call it if it is due after `seconds` of training; returns the seconds it took."""
        if self._every <= 0:
            return 0.0
        if self._due is None:
            self._due = seconds + self._every
        if seconds < self._due:
            return 0.0
        began = time.perf_counter()
        self._call()
        spent = time.perf_counter() - began
        self._due = seconds + max(self._every, 9 * spent)
        return spent
