"""Time limits that hold on a busy machine: how much slower than idle it is."""

from __future__ import annotations

import time

SAMPLE = 0.1  # seconds of work that measure it


def slowness() -> float:
    """Present time of work divided by that on an idle machine; at least 1."""
    began, worked = time.monotonic(), time.thread_time()
    while time.thread_time() - worked < SAMPLE:
        sum(range(1000))
    return max(1.0, (time.monotonic() - began) / SAMPLE)


class Waited:
    """Since when a test waits, and whether that is no longer than on an idle machine."""

    def __init__(self) -> None:
        self._since = time.monotonic()

    def at_most(self, seconds: float) -> bool:
        """Whether less than these seconds went by, as an idle machine counts them."""
        took = time.monotonic() - self._since
        return took < seconds or took < seconds * slowness()
