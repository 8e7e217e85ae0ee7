"""Stop requests: signals, and all other ways to end a command.

Imports only little, and only of the standard library, because signals are watched before anything
else is imported.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import time
from contextlib import suppress
from types import FrameType

INTERRUPTED = 130
"""Exit status after a second Ctrl-C."""
LEAVING_SECONDS = 1.0
"""Time for cleaning up after a second Ctrl-C."""
# A closed terminal sends SIGHUP; Windows sends SIGBREAK for Ctrl-Break and a closed console.
NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
SIGNALS = tuple(getattr(signal, name) for name in NAMES if hasattr(signal, name))


class StopRequest:
    """Whether the command should end, with a checkpoint (`asked`) or at once (`leaving`).

    Plain attributes, set by one assignment: a signal handler may run between any two instructions,
    and a lock could wait for itself.
    """

    def __init__(self) -> None:
        self.asked = False
        self.leaving = False
        self._interrupts = 0

    def watch_signals(self) -> None:
        """Make signals request a stop, and a second Ctrl-C end the command at once.

        A second signal of another kind does not: `timeout` sends SIGTERM twice, a closed terminal
        SIGHUP. If SIGHUP was ignored (`nohup`), it stays ignored.
        """
        for number in SIGNALS:
            if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._take)

    def _take(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGINT:
            self._interrupts += 1
        if self._interrupts > 1:
            self._leave()
        words = [] if self.asked else ["Stopping; finished work is saved."]
        self.asked = True
        if number == signal.SIGINT:
            words.append("Press Ctrl-C again to quit at once, without saving.")
        if words:
            _say(" ".join(words))

    def _leave(self) -> None:
        """Raise KeyboardInterrupt once, so that temporary files and locks are removed.

        The process ends after `LEAVING_SECONDS`, or at a further Ctrl-C.
        """
        if self.leaving:
            os._exit(INTERRUPTED)
        _say("Stopped. Saved work is kept; the same command resumes from it.")
        self.leaving = True
        # Not a `Thread`: the interrupted code may hold the locks that this needs.
        _thread.start_new_thread(_end_soon, ())
        raise KeyboardInterrupt


def _end_soon() -> None:
    time.sleep(LEAVING_SECONDS)
    os._exit(INTERRUPTED)


def _say(text: str) -> None:
    """Write a line to standard error, below the progress bar if there is one."""
    with suppress(OSError, RuntimeError):  # a plain stream refuses a write within a write
        below = sys.stderr.isatty() or getattr(sys.stderr, "in_line", False)
        sys.stderr.write(f"\n{text}\n" if below else f"{text}\n")
