"""How many bytes a second cores move to and from memory: `python -m benchmarks.bandwidth`.

Every thread has arrays of its own, far larger than the caches. `copy` reads one and writes another
(two bytes moved per byte copied); `in place` reads and writes the same array, as an optimizer does.
The best of several passes, since other programs share the memory.
"""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.markdown import table
from roigs_engine.machine import usable_cores

MEBIBYTE = 1 << 20
Floats = NDArray[np.float32]
Work = Callable[[Floats, Floats], object]

WORK: dict[str, Work] = {
    "copy": lambda source, target: np.copyto(target, source),
    "in place": lambda source, _: np.add(source, np.float32(1), out=source),
}
"""What is timed -> a pass over a pair of arrays that moves twice the bytes of one."""


def gigabytes_a_second(work: Work, threads: int, mebibytes: int, passes: int) -> float:
    """All threads together, in the best pass."""
    size = mebibytes * MEBIBYTE // 4
    pairs = [(np.ones(size, np.float32), np.zeros(size, np.float32)) for _ in range(threads)]
    best = float("inf")
    for _ in range(passes + 1):  # the first one gets the memory
        workers = [threading.Thread(target=work, args=pair) for pair in pairs[1:]]
        started = time.perf_counter()
        for worker in workers:
            worker.start()
        work(*pairs[0])
        for worker in workers:
            worker.join()
        best = min(best, time.perf_counter() - started)
    return 2e-9 * 4 * size * threads / best


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a Markdown row per number of threads."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    cores = usable_cores()
    parser.add_argument("--threads", type=int, nargs="+", default=sorted({1, cores}))
    parser.add_argument("--mebibytes", type=int, default=256, help="of an array (256)")
    parser.add_argument("--passes", type=int, default=10, help="10")
    options = parser.parse_args(arguments)
    rows = [
        [str(threads)]
        + [
            f"{gigabytes_a_second(work, threads, options.mebibytes, options.passes):.1f}"
            for work in WORK.values()
        ]
        for threads in options.threads
    ]
    print("\n".join(table(["threads", *(f"{name}, GB/s" for name in WORK)], rows, names=0)))


if __name__ == "__main__":
    main()
