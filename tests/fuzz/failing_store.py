"""A store whose calls fail as a test wants: before they are done, after it, or half done."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

ERRORS: dict[str, Callable[[], Exception]] = {
    "disk": lambda: OSError(5, "Input/output error"),
    "rights": lambda: PermissionError("Access Denied"),
    "reset": lambda: ConnectionResetError(104, "Connection reset by peer"),
    "time": TimeoutError,
    "other": lambda: RuntimeError("An error occurred (SlowDown)\nPlease reduce your request rate"),
    "key": lambda: KeyError("ETag"),
}
"""What packages of stores raise, by a name."""
MOMENTS = ("before", "after", "half")
SILENT = "silent"
"""Instead of a moment: a call that never ends; those that copy files fail."""
Fault = tuple[str, str]
"""A moment and the name of an error."""
WRITES = ("pipe_file", "put_file")


class FailingStore:
    """A file system; `fault` is told each call's name, and says how it fails, if it does."""

    def __init__(self, found: Any, fault: Callable[[str], Fault | None]) -> None:
        self._found, self._fault = found, fault

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._found, name)
        return value if not callable(value) else lambda *a, **k: self._call(name, value, a, k)

    def _call(self, name: str, does: Callable[..., Any], given: Any, more: Any) -> Any:
        fault = self._fault(name)
        if fault is None:
            found = does(*given, **more)
            writes = name == "open" and "wb" in (*given, *more.values())
            return _FailingFile(found, self._fault) if writes else found
        moment, error = fault
        if moment == SILENT and name not in (*WRITES, "get_file", "open"):
            threading.Event().wait()
        if moment == "after" and name != "open":
            does(*given, **more)
        if moment == "half" and name == "pipe_file":
            does(given[0], given[1][: len(given[1]) // 2])
        if moment == "half" and name == "put_file":
            self._found.pipe_file(given[1], b"half")
        raise ERRORS[error]()


class _FailingFile:
    """A file that is written: writing and closing it are calls of the store, too."""

    def __init__(self, file: Any, fault: Callable[[str], Fault | None]) -> None:
        self._file, self._fault = file, fault

    def __enter__(self) -> _FailingFile:
        return self

    def write(self, data: bytes) -> int:
        fault = self._fault("write")
        if fault is None:
            return int(self._file.write(data))
        if fault[0] != "before":
            self._file.write(data[: len(data) // 2])
        raise ERRORS[fault[1]]()

    def __exit__(self, *_: object) -> None:
        fault = self._fault("close")
        self._file.close()
        if fault is not None:
            raise ERRORS[fault[1]]()


@contextmanager
def failing(fault: Callable[[str], Fault | None]) -> Iterator[None]:
    """Have all file systems that are opened meanwhile fail so."""
    import fsspec

    real = fsspec.core.url_to_fs

    def found(url: str, **options: Any) -> tuple[Any, str]:
        system, place = real(url, **options)
        return FailingStore(system, fault), place

    with mock.patch.object(fsspec.core, "url_to_fs", found):
        yield


class Countdown:
    """Fails the calls from the `first`, from 1, so many of them."""

    def __init__(self, first: int, count: int, fault: Fault) -> None:
        self._first, self._last, self._fault = first, first + count - 1, fault
        self._lock, self.calls = threading.Lock(), 0

    def __call__(self, name: str) -> Fault | None:
        with self._lock:
            self.calls += 1
            return self._fault if self._first <= self.calls <= self._last else None
