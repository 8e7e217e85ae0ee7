"""Work that interrupts training now and then."""

from __future__ import annotations

import time
from collections.abc import Callable


class PeriodicCallback:
    """Called every so many seconds of training, and for at most a tenth of the time.

    Args:
        every: seconds between two calls; 0: never called.
        call: what to do.
    """

    def __init__(self, every: float, call: Callable[[], None]) -> None:
        self._every, self._call = every, call
        self._due: float | None = None

    def call_if_due(self, seconds: float) -> float:
        """Call it if it is due after `seconds` of training; the seconds that it took."""
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
