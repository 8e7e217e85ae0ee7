"""Processes many photos in parallel, with as many threads as the machine's memory allows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from ..context import Context
from ..formats.events import StageStarted
from ..machine import machine_memory, usable_cores

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST = 8  # threads
SHARE = 2  # all threads use at most 1/2 of the machine's memory, unless a single one needs more
# Measured bytes for each pixel of a photo during decoding, including Pillow's 4 for the result.
PER_PIXEL = 8  # for a progressive JPEG or a compressed TIFF
HEAVY = {".jp2": 20, ".webp": 17}


def decoding_bytes(path: Path, size: tuple[int, int]) -> int:
    """The most bytes for decoding a photo of `size` = (width, height)."""
    return HEAVY.get(path.suffix.lower(), PER_PIXEL) * size[0] * size[1]


def threads_for(largest: int) -> int:
    """The number of threads if each takes at most `largest` bytes."""
    fitting = machine_memory() // SHARE // max(1, largest)
    return max(1, min(MOST, usable_cores(), fitting))


@contextmanager
def in_parallel(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    memory: int,
    context: Context,
    stage: str = "",
) -> Iterator[Iterator[tuple[Item, Future[Result]]]]:
    """Yield each item, in order, with its finished work; the caller reads the result or error.

    At the end of the block, started work is awaited, and the rest is cancelled.

    Args:
        work: on one item; called on several threads.
        memory: the most bytes for one item.
        stage: name for reports of progress; empty: no reports.
    """
    pool = ThreadPoolExecutor(threads_for(memory), thread_name_prefix="photos")
    jobs = [pool.submit(work, item) for item in items]

    def finished() -> Iterator[tuple[Item, Future[Result]]]:
        started = time.monotonic()
        for step, (item, job) in enumerate(zip(items, jobs, strict=True), start=1):
            while not wait([job], timeout=0.2).done:
                context.check_cancelled()
            context.check_cancelled()
            yield item, job
            if stage:
                context.progress(stage, step, len(jobs), started)

    try:
        if stage and jobs:
            context.emit(StageStarted(stage=stage, total=len(jobs)))
        yield finished()
    finally:
        pool.shutdown(cancel_futures=True)
