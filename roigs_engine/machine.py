"""Memory, processor and disk of the machine that this process runs on."""

from __future__ import annotations

import ctypes
import errno
import functools
import os
import platform
import shutil
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from .errors import EngineError
from .formats.events import Message
from .formats.text import in_gb

ENGINE = 330 << 20  # bytes of Python, torch, the libraries and the kernels, see `run/memory.py`
GIB = 1 << 30
MEMORY_FULL = ("allocate memory", "bad_alloc", "can't start new thread")
MEMORY_MAY_BE_FULL = "failed to map segment"  # or the disk is mounted noexec
NO_MEMORY = "There is not enough memory for this."
FALLBACK_MEMORY = 8 << 30  # bytes, if the machine's memory is unknown


def package(module: str, purpose: str, name: str = "", otherwise: str = "") -> Any:
    """A module of an optional package; EngineError if it is not installed.

    Args:
        module: to import.
        purpose: begins the error's sentence, such as "SPZ".
        name: of the package, as pip knows it; empty: as the module.
        otherwise: a sentence on another way.
    """
    name = name or module.partition(".")[0]
    try:
        return import_module(module)
    except ImportError as error:
        raise EngineError(
            f"{purpose} needs {name}, which is not installed ({error}).",
            f"Run: pip install {name} (Blender: set up the engine again). {otherwise}".rstrip(),
        ) from error


def machine_memory() -> int:
    """Bytes of memory this process can use: the machine's, or its container's or shell's limit."""
    total = FALLBACK_MEMORY
    if sys.platform == "win32":
        total = _windows_memory() or total
    else:
        with suppress(OSError, ValueError):
            total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    total = min(total, address_space() or total)
    try:
        limit = Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii").strip()
        return min(total, int(limit)) if limit.isdigit() else total
    except (OSError, UnicodeDecodeError):
        return total


def address_space() -> int | None:
    """Bytes of addresses that this process may use (`ulimit -v` and `-d`); None: no limit."""
    if sys.platform == "win32":
        return None
    import resource

    limits = [resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA)]
    return min((limit for limit in limits if limit != resource.RLIM_INFINITY), default=None)


def child_environment() -> dict[str, str]:
    """Environment of the engine's own processes: nothing is imported from the working folder."""
    paths = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    own = str(Path(__file__).resolve().parents[1])
    modules = os.pathsep.join([own, *filter(os.path.isabs, paths)])
    return os.environ | {"PYTHONPATH": modules, "PYTHONSAFEPATH": "1"}


def usable_cores() -> int:
    """Number of cores this process may run on; fewer than the machine's if it is pinned."""
    if hasattr(os, "sched_getaffinity"):  # not on Windows and macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def is_memory_full(error: BaseException | None) -> bool:
    """Whether an error means that memory is full; Python, torch and the loader say it variously."""
    while error is not None:
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return True
        if any(words in str(error).lower() for words in MEMORY_FULL):
            return True
        limit = address_space()
        if limit is not None and MEMORY_MAY_BE_FULL in str(error):
            return True
        # Out of memory, some imports fail for reasons of their own.
        if isinstance(error, (ImportError, SystemError)) and (limit or GIB) < GIB:
            return True
        error = error.__cause__ or error.__context__
    return False


def more_memory() -> str:
    """Advice for `NO_MEMORY`."""
    limit = address_space()
    if limit is not None:
        return f"Raise this shell's limit of {limit >> 20} MB (ulimit -v), or use smaller photos."
    return "Use smaller photos (--max-side), or a computer with more memory."


def _windows_memory() -> int:
    """Physical memory in bytes from the Windows API; 0 if the call fails."""

    class Status(ctypes.Structure):
        _fields_ = [
            ("length", ctypes.c_ulong),
            ("load", ctypes.c_ulong),
            ("total", ctypes.c_ulonglong),
            *((f"rest{index}", ctypes.c_ulonglong) for index in range(6)),
        ]

    status = Status(length=ctypes.sizeof(Status))
    kernel = getattr(ctypes, "windll").kernel32  # noqa: B009 (absent elsewhere: not for mypy)
    return int(status.total) if kernel.GlobalMemoryStatusEx(ctypes.byref(status)) else 0


def disk_message(needed: int, folder: Path) -> Message:
    """Tells the bytes that a folder, which need not exist yet, will take; warns if less is free."""
    existing = folder.absolute()
    while not os.path.exists(existing) and existing != existing.parent:
        existing = existing.parent
    try:
        free = shutil.disk_usage(existing).free
    except OSError:
        return Message(text=f"Disk: up to about {in_gb(needed)} more in {folder}.")
    text = f"Disk: up to about {in_gb(needed)} more in {folder}; {in_gb(free)} are free."
    if needed <= free:
        return Message(text=text)
    text += " If the disk gets full, the run stops and can be resumed once there is space."
    return Message(text=text, level="warning")


def release_freed_memory() -> None:
    """Return freed memory to the system; the C library (glibc) would keep it.

    Every densification frees all parameters and their moments, and allocates slightly larger ones.
    The freed blocks are too small for these, so the heap would grow each time.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


LARGE_BLOCK, KEPT_FREE = 8 << 20, 128 << 20  # bytes
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's mallopt


@functools.cache
def return_large_blocks() -> None:
    """Make the C library (glibc) return large blocks to the system once they are freed.

    By itself it keeps those of up to 32 MB: pictures of some megapixels, of which a step frees
    dozens. Measured with `benchmarks.large_capture`, see docs/reliability.md.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(M_MMAP_THRESHOLD, LARGE_BLOCK)
            mallopt(M_TRIM_THRESHOLD, KEPT_FREE)


def processor_name() -> str:
    """The processor's name, read without starting another program."""
    with suppress(OSError):
        for line in (
            Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        ):
            if line.startswith(("model name", "Model")):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
