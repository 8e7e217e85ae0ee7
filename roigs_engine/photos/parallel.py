"""Parallel work on many photos, with as many threads as the machine's memory allows."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import TypeVar

from ..context import Context
from ..machine import machine_memory, usable_cores

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST = 8  # threads
SHARE = 2  # all threads take at most 1/2 of the machine's memory, unless one needs more
# Measured bytes for a pixel of a photo's file while it is decoded, with Pillow's 4 for the result.
PER_PIXEL = 8  # a progressive JPEG, a compressed TIFF
HEAVY = {".jp2": 20, ".webp": 17}


def decoding_bytes(path: Path, size: tuple[int, int]) -> int:
    """Most bytes that decoding a photo takes whose file has `size` = (width, height)."""
    return HEAVY.get(path.suffix.lower(), PER_PIXEL) * size[0] * size[1]


def threads_for(largest: int) -> int:
    """The number of threads if each takes at most `largest` bytes."""
    fitting = machine_memory() // SHARE // max(1, largest)
    return max(1, min(MOST, usable_cores(), fitting))


def in_parallel(
    work: Callable[[Item], Result], items: Sequence[Item], threads: int, context: Context
) -> Generator[tuple[Item, Future[Result]]]:
    """Each item, in order, with its finished work; the caller reads the result or the error.

    Close it (`contextlib.closing`): that waits for work that has begun, and drops the rest.

    Raises:
        Stopped: on request; work that has begun is waited for.
    """
    pool = ThreadPoolExecutor(threads, thread_name_prefix="photos")
    try:
        jobs = [pool.submit(work, item) for item in items]
        for item, job in zip(items, jobs, strict=True):
            while not wait([job], timeout=0.2).done:
                context.check_cancelled()
            context.check_cancelled()
            yield item, job
    finally:
        pool.shutdown(cancel_futures=True)
