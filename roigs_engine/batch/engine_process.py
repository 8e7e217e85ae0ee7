"""Runs an engine process: reads its events, sends stop requests, reports how it ended."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import IO

from ..formats.events import Record, parse_event
from ..machine import child_environment

DONE, STOPPED, FAILED, LOST = "done", "stopped", "failed", "lost"
"""How a part ends: finished; stopped on request; with an error of the engine; with its process or
machine lost, so that it can be retried."""
POLL = 0.5
LAST = 2000  # bytes at the end of standard error, searched for the reason of a failure


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The end of a part: success, or the reason of its failure."""

    state: str  # `DONE`, `STOPPED`, `FAILED` or `LOST`
    reason: str = ""  # one line, for `failed` and `lost`
    node: str = ""  # the machine; empty: this one


def run_engine(
    argv: Sequence[str], emit: Callable[[Record], None], should_stop: Callable[[], bool]
) -> Outcome:
    """Run `python -m roigs_engine ARGV`; `emit` receives each event except the final one.

    `should_stop` is asked twice a second; on a stop, the engine writes a checkpoint first.
    """
    final: Record = {}
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "roigs_engine", *argv, "--events"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=child_environment(),
        )
        ended = threading.Event()
        threading.Thread(target=_stop, args=(process, should_stop, ended), daemon=True).start()
        try:
            assert process.stdout is not None
            for line in process.stdout:
                event = parse_event(line.decode("utf-8", "replace"))
                if event is not None and event["event"] in ("done", "failed"):
                    final = event
                elif event is not None:
                    emit(event)
            status = process.wait()
        finally:
            ended.set()
            for pipe in (process.stdin, process.stdout):
                with suppress(OSError):
                    assert pipe is not None
                    pipe.close()
        return _outcome(status, final, errors)


def _stop(
    process: subprocess.Popen[bytes], should_stop: Callable[[], bool], ended: threading.Event
) -> None:
    """Forward a stop request once."""
    while not ended.wait(POLL):
        if should_stop():
            with suppress(OSError, ValueError):
                assert process.stdin is not None
                process.stdin.write(b"stop\n")
                process.stdin.flush()
            return


def _outcome(status: int, final: Record, errors: IO[bytes]) -> Outcome:
    """The outcome of a process: from its final event, or its status and last line of errors."""
    if final.get("stopped"):
        return Outcome(state=STOPPED)
    if final.get("event") == "done":
        return Outcome(state=DONE)
    if final.get("event") == "failed":
        reason = f"{final.get('message', '')} {final.get('hint', '')}".strip()
        return Outcome(state=FAILED, reason=reason)
    if status < 0:
        memory = " (is the memory full?)" if status == -9 else ""
        return Outcome(state=LOST, reason=f"The engine was ended by signal {-status}{memory}.")
    errors.seek(0, os.SEEK_END)
    errors.seek(max(0, errors.tell() - LAST))
    lines = errors.read().decode("utf-8", "replace").strip().splitlines()
    said = " ".join(lines[-1].split()) if lines else ""
    return Outcome(state=LOST, reason=f"The engine ended with status {status}. {said}".strip())
