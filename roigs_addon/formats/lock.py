"""Who holds the lock of a run folder. No bpy."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

LOCKED_BYTE = 1 << 30


def holder(path: Path) -> int:
    """The process that holds a lock file; 0 when nobody does, as after an engine was killed."""
    try:
        with open(path, "r+b") as file:
            if not _is_locked(file.fileno()):
                return 0
        return int(json.loads(path.read_text(encoding="utf-8"))["pid"])
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return 0


def _is_locked(descriptor: int) -> bool:
    """Whether another process has the lock; if none has, it is taken and given back at once."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return True
        os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)
        return False
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return False
