"""Which process a file belongs to, where the file system has no locks to tell.

A number alone does not tell: the system gives it to another process later, and another computer
gives it to its own.
"""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path
from typing import Any

BOOT = Path("/proc/sys/kernel/random/boot_id")


def identity() -> dict[str, str]:
    """The computer and the start of this process, for a record that also has its `pid`."""
    return {"host": platform.node(), "start": _start(os.getpid())}


def may_live(record: dict[str, Any]) -> bool:
    """Whether the process of a record may still run; False only if it is known to have ended."""
    pid = pid_of(record)
    if not pid or host_of(record) != platform.node():
        return True
    if sys.platform == "win32":  # a signal would end it there
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it is another user's
        pass
    return record.get("start") == _start(pid)


def pid_of(record: dict[str, Any]) -> int:
    """The process that a record names; 0 if it names none."""
    pid = record.get("pid")
    return pid if type(pid) is int and 0 < pid < 1 << 31 else 0


def host_of(record: dict[str, Any]) -> str:
    """The computer that a record names, printable; empty if it names none."""
    host = record.get("host")
    return "".join(c for c in host if c.isprintable())[:100] if isinstance(host, str) else ""


def _start(pid: int) -> str:
    """When the process started, in the system's own terms; empty where that is not known."""
    try:
        boot = BOOT.read_text(encoding="ascii").strip()
        status = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return f"{boot} {status.rpartition(')')[2].split()[19]}"
