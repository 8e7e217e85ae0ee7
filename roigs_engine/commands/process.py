"""A command as a process: its streams and signals, and how it ends."""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Callable
from typing import NoReturn

from .stopping import INTERRUPTED, StopRequest
from .streams import Stream, protect

UNREAD = 141
"""Exit status if the reader of standard output went away (a shell's status after SIGPIPE)."""


def run_process(work: Callable[[StopRequest], int]) -> NoReturn:
    """Do the work with streams that never fail and with signals as stop requests; then exit.

    The process ends at once: cleaning up Python, torch and a large scene takes most of a second,
    and a user who stops a run would wait for it.

    Args:
        work: is given the stop request, and returns an exit status.
    """
    stop = StopRequest()
    stop.watch_signals()
    output = protect(stop)
    try:
        status = _finished(work, stop, output)
    except BaseException:
        if not stop.leaving:
            raise
    # An interrupt may come out as any error, for example out of the middle of an import.
    os._exit(INTERRUPTED if stop.leaving else status)


def _finished(work: Callable[[StopRequest], int], stop: StopRequest, output: Stream) -> int:
    """Do the work; its exit status, or another one if its output was lost."""
    try:
        status = work(stop)
    except SystemExit as end:  # argparse, after --help
        status = int(end.code or 0)
    atexit._run_exitfuncs()
    if status != 0 or output.lost is None:
        return status
    if output.gone:
        return UNREAD
    reason = output.lost.strerror
    sys.stderr.write(
        f"error: Cannot write standard output ({reason})."
        " The work is done; only this text is lost.\n"
    )
    return 2
