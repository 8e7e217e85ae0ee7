"""A command as a process: streams, signals, exit status."""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Callable
from typing import NoReturn

from ..errors import EngineError
from ..machine import NO_MEMORY, address_space, is_memory_full, more_memory, usable_cores
from .stopping import INTERRUPTED, StopRequest
from .streams import Stream, protect

UNREAD = 141
"""Exit status if the reader of standard output has gone (a shell's status after SIGPIPE)."""

# Bytes of address space that numpy needs to start without hanging: in all, plus for each core.
MIN_NUMPY, MIN_NUMPY_CORE = 256 << 20, 40 << 20


def check_address_space(name: str, least: int, each: int) -> None:
    """Refuse a small memory limit of the shell; libraries would abort or hang, and not raise.

    EngineError: it is below `least` bytes plus `each` for each core (stacks and buffers).
    """
    limit, needed = address_space(), least + each * usable_cores()
    if limit is not None and limit < needed:
        raise EngineError(
            f"This shell limits a program's memory to {limit >> 20} MB; {name} needs"
            f" {needed >> 20} MB here.",
            "Raise the limit (ulimit -v).",
        )


def run_process(work: Callable[[StopRequest], int]) -> NoReturn:
    """Do the work with streams that never fail and with signals as stop requests; then exit.

    The work gets the stop request and returns an exit status. The process ends at once, because
    cleaning up Python, torch and a large scene takes most of a second.
    """
    stop = StopRequest()
    stop.watch_signals()
    output = protect(stop)
    try:
        status = _finished(work, stop, output)
    except BaseException:
        if not stop.leaving:
            raise
    # An interrupt may turn into any error, for example in the middle of an import.
    os._exit(INTERRUPTED if stop.leaving else status)


def _finished(work: Callable[[StopRequest], int], stop: StopRequest, output: Stream) -> int:
    """Do the work; returns its exit status, or another one if its output was lost."""
    try:
        check_address_space("the engine", MIN_NUMPY, MIN_NUMPY_CORE)
        status = work(stop)
    except SystemExit as end:  # argparse, after --help
        status = int(end.code or 0)
    except EngineError as error:
        return _failed(str(error))
    except Exception as error:
        if not is_memory_full(error):  # from an import, or from reporting an error
            raise
        return _failed(f"{NO_MEMORY} {more_memory()}")
    atexit._run_exitfuncs()
    if status != 0 or output.lost is None:
        return status
    if output.gone:
        return UNREAD
    reason = output.lost.strerror
    return _failed(
        f"Cannot write standard output ({reason}). The work is done; only this text is lost."
    )


def _failed(text: str) -> int:
    sys.stderr.write(f"error: {text}\n")
    return 2
