"""One engine at a time in a run folder, and a way for others to see that it is at work.

The lock is the operating system's, so it ends with the process, however that ends. The file says
who holds it, for people and for a Blender that was opened again.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ..errors import RunFolderError
from .run_files import EVENTS, LOCK

# Windows keeps others from reading what is locked, so a byte far behind the text is locked.
LOCKED_BYTE = 1 << 30


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold `folder`/run.lock while the block runs; `{"pid", "started", "events_from"}` is in it.

    `started` is in seconds since 1970; `events_from` is the size that events.jsonl had then. The
    file is removed at the end. One that a killed process has left is taken over.

    Raises:
        RunFolderError: another process holds it, or the folder cannot be written to.
    """
    path = folder / LOCK
    try:
        file = _hold(path)
        _write_record(file, folder / EVENTS)
    except BlockingIOError as error:
        raise RunFolderError(
            f"Another engine is at work in {folder}{_holder(path)}.",
            "Wait for it, stop it, or choose another run folder (--run-dir).",
        ) from error
    except OSError as error:
        raise RunFolderError(
            f"Cannot write {path} ({error.strerror or error}).",
            "Free some space or choose another folder.",
        ) from error
    try:
        yield
    finally:
        if sys.platform == "win32":  # a file that is open cannot be removed there
            file.close()
        with suppress(OSError):
            path.unlink()
        file.close()
        with suppress(OSError):  # nothing but the lock was ever in it
            folder.rmdir()


def _hold(path: Path) -> BinaryIO:
    """The locked file; BlockingIOError when another process has it."""
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = open(path, "a+b")  # noqa: SIM115 - stays open as long as the lock is held
        try:
            _lock(file)
            # The last holder may have removed the file between the two lines above.
            if path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat()):
                return file
        except BaseException:
            file.close()
            raise
        file.close()


def _write_record(file: BinaryIO, log: Path) -> None:
    """Say in the file who holds it."""
    record = {
        "pid": os.getpid(),
        "started": round(time.time(), 3),
        "events_from": log.stat().st_size if log.exists() else 0,
    }
    try:
        file.truncate(0)
        file.seek(0)
        file.write(json.dumps(record).encode() + b"\n")
        file.flush()
    except OSError:
        with suppress(OSError):  # what could not be written is tried again here
            file.close()
        raise


def _lock(file: BinaryIO) -> None:
    """Take the lock at once; BlockingIOError when another process has it."""
    if sys.platform == "win32":
        import msvcrt

        file.seek(LOCKED_BYTE)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError from error
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def holder(path: Path) -> int:
    """The process that holds a lock file; 0 when nobody does, as after an engine was killed."""
    try:
        with open(path, "r+b") as file:
            return _recorded(path) if _is_locked(file) else 0
    except OSError:
        return 0


def _is_locked(file: BinaryIO) -> bool:
    """Whether another process has the lock; if none has, it is taken and given back at once."""
    if sys.platform == "win32":
        import msvcrt

        try:
            _lock(file)
        except BlockingIOError:
            return True
        file.seek(LOCKED_BYTE)
        msvcrt.locking(file.fileno(), msvcrt.LK_UNLCK, 1)
        return False
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(file, fcntl.LOCK_UN)
    return False


def _recorded(path: Path) -> int:
    """The process that the file names; 0 where it names none."""
    with suppress(OSError, ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return int(json.loads(path.read_text(encoding="utf-8"))["pid"])
    return 0


def _holder(path: Path) -> str:
    """ ", process N", when the file says so."""
    process = _recorded(path)
    return f", process {process}" if process else ""
