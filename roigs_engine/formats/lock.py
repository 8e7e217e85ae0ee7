"""One engine at a time in a run folder, and a way for others to see that it is at work.

The lock is the operating system's, so it ends with the process, however that ends. The file says
who holds it, for people and for a Blender that was opened again. On a file system without locks,
the file itself is the lock (`lock_file`).
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO

from ..errors import RunFolderError
from . import os_lock, process
from .files import cannot_write, is_link, unlinked
from .lock_file import MayLiveError, hold_by_name, read_record, write_record
from .run_files import EVENTS, LOCK

_held: dict[Path, BinaryIO] = {}
"""Lock files that this process holds."""


def _say_nothing(text: str) -> None:
    """Drop the warning."""


@contextmanager
def locked(
    folder: Path,
    warn: Callable[[str], None] = _say_nothing,
    option: str | None = "--run-dir",
    name: str = LOCK,
) -> Iterator[None]:
    """Hold `folder`/run.lock while the block runs; `{"pid", "started", "events_from"}` is in it.

    `started` is in seconds since 1970; `events_from` is the size that events.jsonl had then. The
    file is removed at the end. One that a killed process has left is taken over.

    Args:
        folder: the run folder; created if it is missing.
        warn: told if the file system has no locks.
        option: of the command, which names another folder; None: it works in this one alone.
        name: of the lock file.

    Raises:
        RunFolderError: another process holds it, or the folder cannot be written to.
    """
    path = Path(os.path.abspath(folder), name)
    try:
        file = _hold(path, warn)
    except BlockingIOError as error:
        raise _in_use(path, error, option) from error
    except OSError as error:
        raise cannot_write(path, error) from error
    _held[path] = file
    try:
        yield
    finally:
        del _held[path]
        _release(path, file)
        with suppress(OSError):  # nothing but the lock was ever in it
            path.parent.rmdir()


def check_held(path: Path) -> None:
    """Make sure that a lock of this process above `path` is still its own, if it has one.

    Raises:
        RunFolderError: somebody deleted or replaced the lock file, so another engine may be at
            work in the folder.
    """
    place = Path(os.path.abspath(path))
    for lock, file in _held.items():
        if place.is_relative_to(lock.parent) and not _is_at(lock, file):
            raise RunFolderError(
                f"{lock} was deleted or replaced while this engine used it;"
                " another engine may be at work in the folder.",
                "Once no other engine is at work there, give the same command again to resume.",
            )


def holder(path: Path) -> int:
    """The process that holds a lock file; 0 when nobody does, as after an engine was killed."""
    try:
        with open(path, "r+b", opener=unlinked) as file:
            try:
                taken = os_lock.is_taken(file)
            except os_lock.NoLocksError:
                taken = process.may_live(read_record(path))
            return process.pid_of(read_record(path)) if taken else 0
    except OSError:
        return 0


def _hold(path: Path, warn: Callable[[str], None]) -> BinaryIO:
    """The file, locked and with its record; BlockingIOError if another process has it."""
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        if is_link(path):
            path.unlink()
        if not _has_locks(path.parent):
            warn(
                f"The file system of {path.parent} has no locks. Make sure that only one computer"
                " uses this folder at a time."
            )
            return hold_by_name(path, _record_of_now(path) | process.identity())
        file = open(path, "a+b", opener=unlinked)  # noqa: SIM115 - open while the lock is held
        try:
            if not os_lock.take(file):
                raise BlockingIOError
            names = os.fstat(file.fileno()).st_nlink
            # The last holder may have removed the file between the lines above.
            if _is_at(path, file) and names <= 1:  # some file systems count none
                write_record(file, _record_of_now(path))
                return file
            if names > 1 and _is_at(path, file):  # a hard link: what it names is not ours to write
                _release(path, file)
        except BaseException:
            with suppress(OSError):  # what could not be written is tried again here
                file.close()
            raise
        file.close()


def _has_locks(folder: Path) -> bool:
    with TemporaryFile(dir=folder) as file:
        try:
            return os_lock.take(file)
        except os_lock.NoLocksError:
            return False


def _release(path: Path, file: BinaryIO) -> None:
    """Remove the file, unless another process has put its own there; end the lock."""
    ours = _is_at(path, file)
    if sys.platform == "win32":  # a file that is open cannot be removed there
        file.close()
    if ours:
        with suppress(OSError):
            path.unlink()
    file.close()


def _is_at(path: Path, file: BinaryIO) -> bool:
    """Whether the open file is the one of that name."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), os.lstat(path))
    except OSError:
        return False


def _record_of_now(path: Path) -> dict[str, Any]:
    """What the file says of this process."""
    log = path.with_name(EVENTS)
    return {
        "pid": os.getpid(),
        "started": round(time.time(), 3),
        "events_from": log.stat().st_size if log.exists() else 0,
    }


def _in_use(path: Path, error: BlockingIOError, option: str | None) -> RunFolderError:
    """The error for a folder that another process uses."""
    record = read_record(path)
    pid, host = process.pid_of(record), process.host_of(record)
    who = f", process {pid}" if pid else ""
    where = f" on {host}" if host else ""
    other = f", stop it, or choose another folder ({option})" if option else ", or stop it"
    hint = f"Wait for it{other}."
    if isinstance(error, MayLiveError):
        hint += f" If no engine is at work there, delete {path}."
    return RunFolderError(f"Another engine is at work in {path.parent}{who}{where}.", hint)
