"""File locks of the operating system. They end with the process, even if it is killed.

`take` and `is_taken` raise `NoLocksError` on a file system without locks.
"""

from __future__ import annotations

import errno
import os
import sys
from typing import BinaryIO

NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP}


class NoLocksError(Exception):
    """The file system has no locks, like some network drives."""


if sys.platform == "win32":
    import msvcrt

    # On Windows, other processes cannot read locked bytes, so the lock is on a byte far beyond the
    # text.
    LOCKED_BYTE = 1 << 30

    def take(file: BinaryIO) -> bool:
        """Take the lock of an open file at once; False if another process has it."""
        file.seek(LOCKED_BYTE)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        except OSError as error:
            if error.errno in NO_LOCKS:
                raise NoLocksError from error
            raise
        return True

    def is_taken(file: BinaryIO) -> bool:
        """Whether another process has the lock; if none has, it is taken and given back."""
        if not take(file):
            return True
        file.seek(LOCKED_BYTE)
        msvcrt.locking(file.fileno(), msvcrt.LK_UNLCK, 1)
        return False

    def keep(file: BinaryIO) -> int | None:
        """Return None, without a lock: Windows does not delete open files."""
        return None

else:
    import fcntl

    def take(file: BinaryIO) -> bool:
        """Take the lock of an open file at once; False if another process has it."""
        return _flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def is_taken(file: BinaryIO) -> bool:
        """Whether another process has the lock; if none has, it is taken and given back."""
        if not _flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB):
            return True
        fcntl.flock(file, fcntl.LOCK_UN)
        return False

    def keep(file: BinaryIO) -> int | None:
        """Wait for the lock of an open file; it lasts until the returned descriptor is closed.

        None on a file system without locks.
        """
        try:
            _flock(file, fcntl.LOCK_EX)
        except NoLocksError:
            return None
        return os.dup(file.fileno())

    def _flock(file: BinaryIO, how: int) -> bool:
        """Whether the lock was taken."""
        try:
            fcntl.flock(file, how)
        except BlockingIOError:
            return False
        except OSError as error:
            if error.errno in NO_LOCKS:
                raise NoLocksError from error
            raise
        return True
