"""Opens an OpenUSD file in a separate process first: a bad file may crash it or fill its memory.

`python -m roigs_engine.exchange.usd_probe FILE LIMIT DEEPEST` ends with one of the codes below.
"""

from __future__ import annotations

import os
import sys
import threading
from contextlib import suppress
from importlib import import_module
from typing import Any

FINE, TOO_LARGE, TOO_DEEP = 0, 3, 4
LIBRARIES = 4 << 30  # bytes of addresses for the libraries themselves
STACK = 1 << 20  # bytes; less than the stack of the process that opens the file afterwards


def _size(value: Any) -> int:
    """Return about how many bytes the numbers of an array take; 0 if it is no array."""
    try:
        return memoryview(value).nbytes
    except TypeError:
        return 8 * len(value) if hasattr(value, "__len__") else 0


def _probe(path: str, limit: int, deepest: int) -> int:
    sdf = import_module("pxr.Sdf")
    unpacked, code = 0, FINE
    layer = sdf.Layer.OpenAsAnonymous(path)

    def visit(place: Any) -> None:
        nonlocal unpacked, code
        if place.pathElementCount > deepest:
            code = TOO_DEEP
        spec = layer.GetObjectAtPath(place)
        if code != FINE or not isinstance(spec, sdf.AttributeSpec):
            return
        unpacked += _size(spec.default)
        if times := layer.ListTimeSamplesForPath(place):
            unpacked += _size(layer.QueryTimeSample(place, times[0]))
        if unpacked > limit:
            code = TOO_LARGE

    if layer:
        layer.Traverse(sdf.Path.absoluteRootPath, visit)
    return code


def main(path: str, limit: int, deepest: int) -> int:
    """Return one of the codes; FINE also for a file that OpenUSD refuses with an error."""
    with suppress(ImportError, OSError, ValueError):  # Windows has none; or a limit is already set
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (LIBRARIES + limit, LIBRARIES + limit))
    found = [TOO_LARGE]  # stays if the thread ends with an error of memory

    def run() -> None:
        with suppress(MemoryError):
            try:
                found[0] = _probe(path, limit, deepest)
            except RuntimeError:
                found[0] = FINE

    threading.stack_size(STACK)
    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return found[0]


def end_with_parent() -> None:
    """End this process when its standard input, a pipe of the waiting process, is closed."""
    while os.read(0, 1):
        pass
    os._exit(TOO_LARGE)


if __name__ == "__main__":
    threading.Thread(target=end_with_parent, daemon=True).start()
    raise SystemExit(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
