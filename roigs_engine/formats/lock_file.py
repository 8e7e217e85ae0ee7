"""The lock file of a run folder: its record, and how it is the lock where there is no other.

On a file system without locks, a lock file belongs to the process that its record names. It
appears with its record or not at all, and is taken over only if that process has ended.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from . import process
from .files import new_temporary, read_bytes

NO_LINKS = {errno.EPERM, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EMLINK}


class MayLiveError(BlockingIOError):
    """The process of a lock file may still run; only a person can tell."""


def write_record(file: BinaryIO, record: dict[str, Any]) -> None:
    """Make the record the content of an open file."""
    file.truncate(0)
    file.seek(0)
    file.write(json.dumps(record).encode() + b"\n")
    file.flush()


def read_record(path: Path) -> dict[str, Any]:
    """What a lock file says; empty if it is missing or damaged."""
    try:
        return _parsed(read_bytes(path))
    except OSError:
        return {}


def hold_by_name(path: Path, record: dict[str, Any]) -> BinaryIO:
    """The lock file, created by this process with its record.

    Args:
        path: the lock file; one of a process that has ended is taken over.
        record: with the `pid` and the `process.identity` of this process.

    Raises:
        MayLiveError: the file of another process is there, which may still run.
        OSError: it cannot be written.
    """
    while True:
        try:
            found = read_bytes(path)
        except FileNotFoundError:
            with suppress(FileExistsError):
                return _created(path, record)
            continue
        if process.may_live(_parsed(found)):
            raise MayLiveError
        file = _taken_over(path, found, record)
        if file is not None:
            return file


def _created(path: Path, record: dict[str, Any]) -> BinaryIO:
    """The new file, open; FileExistsError if another process was faster."""
    temporary, file, _ = new_temporary(path)
    try:
        write_record(file, record)
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
    write_record(file, record)
    return file


def _taken_over(path: Path, found: bytes, record: dict[str, Any]) -> BinaryIO | None:
    """The file of a process that has ended, now this one's; None if another one was faster.

    Only the process that holds the file named after the old content may replace that content. It
    does so in one step, so that at no moment there is no file, which others would create.
    """
    claim = path.with_name(f".{path.name}.{hashlib.sha256(found).hexdigest()[:16]}")
    right = hold_by_name(claim, record)
    try:
        if not _has_content(path, found):
            return None
        temporary, file, _ = new_temporary(path)
        write_record(file, record)
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
