"""Faults from outside, which the engine's process does to itself.

Its standard input and output are pipes whose other ends it holds, so that it can close them.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path


def connect(errors: Path) -> None:
    """Make standard input and output pipes, and standard error a file."""
    source, ENDS["input"] = os.pipe()
    ENDS["output"], sink = os.pipe()
    log = os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for number, end in enumerate((source, sink, log)):
        os.dup2(end, number)
        os.close(end)
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115


ENDS: dict[str, int] = {}


def _signals(*numbers: str) -> Callable[[], None]:
    """Signals that come one right after the other."""

    def happen() -> None:
        for name in numbers:
            os.kill(os.getpid(), getattr(signal, name))

    return happen


def _full() -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _impatience() -> None:
    """Ctrl-C again and again, while the engine goes on."""

    def press(pauses: Sequence[float]) -> None:
        for pause in pauses:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(pause)

    pauses = (0.002, 0.005, 0.001, 0.01, 0.02, 0.05)
    threading.Thread(target=press, args=(pauses,), daemon=True).start()


def _vanish() -> None:
    """The terminal is gone: nobody reads, and the kernel and the shell both say so."""
    os.close(ENDS["output"])
    _signals("SIGHUP", "SIGHUP")()


FAULTS: dict[str, Callable[[], None]] = {
    "killed": _signals("SIGKILL"),
    "full": _full,
    "interrupted": _signals("SIGINT"),
    "impatience": _impatience,
    "terminated": _signals("SIGTERM", "SIGTERM"),  # as `timeout` does
    "hangup": _vanish,
    "reader": lambda: os.close(ENDS["output"]),
    "input": lambda: os.close(ENDS["input"]),
}
"""By name; `full` is a full disk."""
WITH_EVENTS = ("reader", "input")  # read and written all the time only with --events
ENDINGS = {
    "killed": {-9},
    "full": {2},
    "interrupted": {3, 0},
    "impatience": {130, 3, 0},
    "terminated": {3, 0},
    "hangup": {3, 0, 141},
    "reader": {3, 0, 141},
    "input": {3, 0},
}
"""Exit statuses after each; 0 if nothing was left to stop."""
