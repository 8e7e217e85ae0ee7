"""Runs the worker process: its progress, its errors, stopping it."""

from __future__ import annotations

import json
import queue
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from ..context import Context
from ..errors import EngineError, SceneError
from ..formats.events import StageStarted
from ..formats.files import cannot_write, unlinked
from ..machine import child_environment

Record = dict[str, Any]
POLL_SECONDS = 0.25
FULL = 16 << 20  # bytes; SQLite may fail with less
WORKER = [sys.executable, "-m", f"{__package__}.worker"]


def run_stage(
    task: Record, log: Path, stage: str, total: int, done: Callable[[Record], int], context: Context
) -> Any:
    """Run a task as a stage of the reconstruction; raises and returns as `run_task`.

    `done`: the child's last record -> number of finished units, of `total`.
    """
    context.emit(StageStarted(stage=stage, total=total))
    began = time.monotonic()

    def poll(record: Record) -> None:
        if count := min(done(record), total):
            context.progress(stage, count, total, began)

    return run_task(task, log, context, poll)


def run_task(
    task: Record, log: Path, context: Context, poll: Callable[[Record], None] = lambda record: None
) -> Any:
    """Run a task of `worker` in a child process, and return its result.

    Args:
        task: as JSON values; `work` is its name.
        log: file for pycolmap's messages.
        context: checked for cancellation four times a second. The child is then killed; SQLite
            keeps the database consistent.
        poll: called as often, with the child's last record.

    Raises:
        SceneError: pycolmap failed.
        RunFolderError: the log cannot be written.
        EngineError: pycolmap is missing or too old, or cannot be started.
    """
    with _opened(log) as messages:
        child = subprocess.Popen(
            WORKER,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=messages,
            env=child_environment(),
            # In its own session, so that Ctrl-C only reaches this process.
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )
        try:
            return _result(child, task, log, context, poll)
        finally:
            child.kill()
            child.wait()
            for stream in (child.stdin, child.stdout):
                if stream is not None:
                    with suppress(OSError):
                        stream.close()


def _opened(log: Path) -> BinaryIO:
    """Open the log to append; RunFolderError if it cannot be written, or is a pipe or link."""
    try:
        return open(log, "ab", opener=unlinked)
    except OSError as error:
        raise cannot_write(log, error) from error


def _result(
    child: subprocess.Popen[bytes],
    task: Record,
    log: Path,
    context: Context,
    poll: Callable[[Record], None],
) -> Any:
    assert child.stdin is not None and child.stdout is not None
    output, lines = child.stdout, queue.SimpleQueue[bytes | None]()

    def read() -> None:
        """Queue the child's lines, then None."""
        with suppress(ValueError, OSError):  # the pipe is closed
            for line in output:
                lines.put(line)
        lines.put(None)

    threading.Thread(target=read, daemon=True).start()
    with suppress(OSError):  # the process has ended; reported below
        child.stdin.write(json.dumps(task).encode() + b"\n")
        child.stdin.flush()
    last: Record = {}
    while True:
        context.check_cancelled()
        try:
            line = lines.get(timeout=POLL_SECONDS)
        except queue.Empty:
            poll(last)
            continue
        if line is None:
            raise _ended(child.wait(), log)
        record: Record = {}
        with suppress(ValueError, TypeError):  # not a record
            record = dict(json.loads(line))
        if "error" in record and not record.get("hint") and _is_full(log):
            raise _ended(1, log)
        if "error" in record:
            raise (EngineError if record.get("hint") else SceneError)(
                record["error"], record.get("hint", f"Log: {log}")
            )
        if "result" in record:
            return record["result"]
        last = record or last
        poll(last)


def _is_full(log: Path) -> bool:
    return shutil.disk_usage(log.parent).free < FULL


def _ended(status: int, log: Path) -> SceneError:
    """The error for a child that ended without a result: pycolmap aborts when a disk is full."""
    if _is_full(log):
        return SceneError(
            f"The disk of {log.parent} is full.", "Free some space and give the command again."
        )
    return SceneError(
        f"pycolmap ended without a result (exit status {status}).",
        f"Check the free memory, then give the command again. Log: {log}",
    )
