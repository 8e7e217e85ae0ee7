"""When the card's memory is full: the numbers, and what to make smaller."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch

from ..errors import KernelError

GIB = 1 << 30


@contextmanager
def explain_out_of_memory(doing: Callable[[], str], advice: Callable[[], str]) -> Iterator[None]:
    """Turns torch's out-of-memory error into one line.

    Args:
        doing: what goes on, with its numbers; said after 'is full'.
        advice: what to change.

    Raises:
        KernelError: the card's memory is full.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        message = f"The graphics card's memory{_used()} is full: {doing()}."
        raise KernelError(message, advice()) from error


def smaller_side(width: int, height: int) -> int:
    """A longest side, in pixels, to propose in place of that of (width, height)."""
    return max(64, max(width, height) * 3 // 4)


def _used() -> str:
    """How full the card is, in brackets; empty where there is none."""
    if not torch.cuda.is_available():
        return ""
    free, total = torch.cuda.mem_get_info()
    ours = torch.cuda.max_memory_allocated()
    return f" ({total / GIB:.1f} GiB, {free / GIB:.1f} free, {ours / GIB:.1f} at most used by this)"
