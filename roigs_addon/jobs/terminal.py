"""Progress and stopping in a terminal or a log, for `blender -b`. No bpy."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TextIO

LOG_SECONDS = 5.0


class Terminal:
    """Shows progress: one changing line in a terminal; in a log, a line every few seconds."""

    def __init__(self, stream: TextIO, *, every: float = LOG_SECONDS) -> None:
        """Write to `stream`; `every` is the least number of seconds between lines of a log."""
        self._stream, self._every = stream, every
        self._alive = stream.isatty()
        self._last, self._topic, self._width = "", "", 0
        self._next = 0.0

    def show(self, text: str, topic: str = "") -> None:
        """Show the progress; in a log only every few seconds, but a new topic at once."""
        if text == self._last:
            return
        if self._alive:
            print(f"\r{text:{self._width}}", end="", file=self._stream, flush=True)
            self._last, self._width = text, len(text)
        elif topic != self._topic or time.monotonic() >= self._next:
            print(text, file=self._stream, flush=True)
            self._last, self._topic = text, topic
            self._next = time.monotonic() + self._every

    def line(self, text: str) -> None:
        """Print a line that stays."""
        self.close()
        print(text, file=self._stream, flush=True)

    def close(self) -> None:
        """Finish the line that changes."""
        if self._width:
            print(file=self._stream, flush=True)
        self._width = 0


@contextmanager
def stopping(stop: Callable[[], None]) -> Iterator[None]:
    """While the block runs, Ctrl-C and SIGTERM call `stop`; a second one raises KeyboardInterrupt.

    Outside the main thread, where Python handles no signals, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked = False

    def take(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        stop()

    before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            # None stands for a handler of Blender's own, which Python cannot restore.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
