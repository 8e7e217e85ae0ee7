"""Locks of run folders: only one engine at a time, and others can see which.

The lock is the operating system's, so it is released when the process ends, in any way. The file
names its holder, for users and for a restarted Blender.

A file system without locks needs a fallback. There, a lock file belongs to the process in its
record. The file appears together with its record, and is taken over only if that process has ended.
The system reuses process numbers, so the record also has the computer and the start time of the
process.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO

from ..errors import RunFolderError
from . import os_lock
from .files import LARGEST, cannot_write, is_link, new_temporary, read_bytes, unlinked
from .others import says_other
from .run_files import EVENTS, LOCK

KEYS = {"pid", "started", "events_from"}
"""Keys in every lock file of the engine."""

_held: dict[Path, BinaryIO] = {}
"""Lock files that this process holds."""


@contextmanager
def locked(
    folder: Path,
    warn: Callable[[str], object] = lambda text: None,
    option: str | None = "--run-dir",
    name: str = LOCK,
) -> Iterator[None]:
    """Hold the lock `folder`/run.lock while the block runs.

    The file contains `{"pid", "started", "events_from"}`: `started` is in seconds since 1970, and
    `events_from` is the size of events.jsonl at that time. The file is removed at the end. The file
    of a killed process is taken over.

    Args:
        folder: the run folder; created if it is missing.
        warn: called if the file system has no locks.
        option: the command's option that chooses another folder, for hints; None: it has none.
        name: of the lock file.

    Raises:
        RunFolderError: another process holds it, the folder cannot be written to, or the file is
            not of the engine.
    """
    path = Path(os.path.abspath(folder), name)
    try:
        file = _hold(path, warn, option)
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
        with suppress(OSError):  # fails unless the folder is empty
            path.parent.rmdir()


def check_held(path: Path) -> None:
    """Raise RunFolderError if somebody deleted or replaced a lock of this process above `path`."""
    place = Path(os.path.abspath(path))
    for lock, file in _held.items():
        if place.is_relative_to(lock.parent) and not _is_at(lock, file):
            raise RunFolderError(
                f"{lock} was deleted or replaced while this engine used it;"
                " another engine may be at work in the folder.",
                "Once no other engine is at work there, give the same command again to resume.",
            )


def holder(path: Path) -> int:
    """The number of the process that holds a lock file; 0 if none does (after a kill, say)."""
    try:
        with open(path, "r+b", opener=unlinked) as file:
            try:
                taken = os_lock.is_taken(file)
            except os_lock.NoLocksError:
                taken = _may_live(_read_record(path))
            return _pid_of(_read_record(path)) if taken else 0
    except OSError:
        return 0


def is_lock(path: Path) -> bool:
    """Whether a file is an engine's lock, not another program's file of the same name."""
    return _read_record(path).keys() >= KEYS


def _refuse_others(path: Path, file: BinaryIO, option: str | None) -> None:
    """Raise RunFolderError if another program wrote the file."""
    file.seek(0)
    if says_other(file.read(LARGEST).strip(b"\0"), KEYS):
        other = f", or choose another folder ({option})" if option else ""
        raise RunFolderError(
            f"{path} was not written by the engine, which needs this name for its lock.",
            f"Move it{other}.",
        )


def _hold(path: Path, warn: Callable[[str], object], option: str | None) -> BinaryIO:
    """Lock the file, write its record and return it open.

    BlockingIOError: another process holds it. RunFolderError: another program wrote it.
    """
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        if is_link(path):
            path.unlink()
        if not _has_locks(path.parent):
            warn(
                f"The file system of {path.parent} has no locks. Make sure that only one computer"
                " uses this folder at a time."
            )
            return _hold_by_name(path, _record_of_now(path) | identity())
        file = open(path, "a+b", opener=unlinked)  # noqa: SIM115 - open while the lock is held
        try:
            if not os_lock.take(file):
                raise BlockingIOError
            names = os.fstat(file.fileno()).st_nlink
            # The last holder may have removed the file between the lines above.
            if _is_at(path, file) and names <= 1:  # some file systems report 0 links
                _refuse_others(path, file, option)
                _write_record(file, _record_of_now(path))
                return file
            if names > 1 and _is_at(path, file):  # a hard link, perhaps to a user's file
                _release(path, file)
        except BaseException:
            with suppress(OSError):  # closing tries the failed write again
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
    if sys.platform == "win32":  # open files cannot be removed there
        file.close()
    if ours:
        with suppress(OSError):
            path.unlink()
    file.close()


def _is_at(path: Path, file: BinaryIO) -> bool:
    """Whether the open file is still the one at `path`."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), os.lstat(path))
    except OSError:
        return False


def _record_of_now(path: Path) -> dict[str, Any]:
    log = path.with_name(EVENTS)
    return {
        "pid": os.getpid(),
        "started": round(time.time(), 3),
        "events_from": log.stat().st_size if log.exists() else 0,
    }


def _in_use(path: Path, error: BlockingIOError, option: str | None) -> RunFolderError:
    record = _read_record(path)
    pid, host = _pid_of(record), _host_of(record)
    who = f", process {pid}" if pid else ""
    where = f" on {host}" if host else ""
    other = f", stop it, or choose another folder ({option})" if option else ", or stop it"
    hint = f"Wait for it{other}."
    if isinstance(error, MayLiveError):
        hint += f" If no engine is at work there, delete {path}."
    return RunFolderError(f"Another engine is at work in {path.parent}{who}{where}.", hint)


NO_LINKS = {errno.EPERM, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EMLINK}


class MayLiveError(BlockingIOError):
    """The process of a lock file may still run; only a person can tell."""


def _write_record(file: BinaryIO, record: dict[str, Any]) -> None:
    file.truncate(0)
    file.seek(0)
    file.write(json.dumps(record).encode() + b"\n")
    file.flush()


def _read_record(path: Path) -> dict[str, Any]:
    """The content of a lock file; empty if it is missing or damaged."""
    try:
        return _parsed(read_bytes(path))
    except OSError:
        return {}


def _hold_by_name(path: Path, record: dict[str, Any]) -> BinaryIO:
    """Create the lock file, or take it over from a process that has ended; return it open.

    Its record has the `pid` and the `identity` of this process. MayLiveError: it belongs to another
    process, which may still run. OSError: it cannot be written.
    """
    while True:
        try:
            found = read_bytes(path)
        except FileNotFoundError:
            with suppress(FileExistsError):
                return _created(path, record)
            continue
        if _may_live(_parsed(found)):
            raise MayLiveError
        file = _taken_over(path, found, record)
        if file is not None:
            return file


def _created(path: Path, record: dict[str, Any]) -> BinaryIO:
    """Create the lock file and return it open; FileExistsError if another process was faster."""
    temporary, file, _ = new_temporary(path)
    try:
        _write_record(file, record)
        os.link(temporary, path)
        return file
    except OSError as error:
        with suppress(OSError):
            file.close()
        if error.errno not in NO_LINKS:
            raise
    finally:
        with suppress(OSError):
            temporary.unlink()
    file = open(path, "xb")  # noqa: SIM115 - open while the lock is held
    _write_record(file, record)
    return file


def _taken_over(path: Path, found: bytes, record: dict[str, Any]) -> BinaryIO | None:
    """Take over the file of a process that has ended; None if another process was faster.

    Only the process that holds the file named after the old content may replace that content. It
    does so in one step. So the file always exists, and no other process can create it.
    """
    claim = path.with_name(f".{path.name}.{hashlib.sha256(found).hexdigest()[:16]}")
    right = _hold_by_name(claim, record)
    try:
        if not _has_content(path, found):
            return None
        temporary, file, _ = new_temporary(path)
        _write_record(file, record)
        os.replace(temporary, path)
        return file
    finally:
        right.close()
        with suppress(OSError):
            claim.unlink()


def _has_content(path: Path, content: bytes) -> bool:
    try:
        return read_bytes(path) == content
    except OSError:
        return False


def _parsed(content: bytes) -> dict[str, Any]:
    with suppress(ValueError, RecursionError):
        record = json.loads(content)
        return record if isinstance(record, dict) else {}
    return {}


BOOT = Path("/proc/sys/kernel/random/boot_id")


def identity() -> dict[str, str]:
    """The computer and the start of this process, for a record that also has its `pid`."""
    return {"host": platform.node(), "start": _start(os.getpid())}


def _may_live(record: dict[str, Any]) -> bool:
    """Whether the process of a record may still run; False only if it is known to have ended."""
    pid = _pid_of(record)
    if not pid or _host_of(record) != platform.node():
        return True
    if sys.platform == "win32":  # there, the signal below would end the process
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's process
        pass
    return record.get("start") == _start(pid)


def _pid_of(record: dict[str, Any]) -> int:
    """The process that a record names; 0 if it names none."""
    pid = record.get("pid")
    return pid if type(pid) is int and 0 < pid < 1 << 31 else 0


def _host_of(record: dict[str, Any]) -> str:
    """The computer that a record names, printable; empty if it names none."""
    host = record.get("host")
    return "".join(c for c in host if c.isprintable())[:100] if isinstance(host, str) else ""


def _start(pid: int) -> str:
    """The start time of a process, as the system records it; empty if it is unknown."""
    try:
        boot = BOOT.read_text(encoding="ascii").strip()
        status = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return f"{boot} {status.rpartition(')')[2].split()[19]}"
