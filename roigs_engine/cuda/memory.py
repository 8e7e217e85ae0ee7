"""When the card's memory is full: the numbers, and what to make smaller."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch

from ..errors import KernelError

GIB = 1 << 30


@contextmanager
def memory_explained(
    doing: Callable[[], str], size: Callable[[], tuple[int, int]]
) -> Iterator[None]:
    """Turns torch's out-of-memory error into one line.

    Args:
        doing: what goes on, with its numbers, to be said after «is full».
        size: width and height of what is drawn, pixels.

    Raises:
        KernelError: the card's memory is full.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        smaller = max(64, max(size()) * 3 // 4)
        raise KernelError(
            f"The graphics card's memory{_used()} is full: {doing()}.",
            f"Close what else uses the card, or use smaller photos (--max-side {smaller}) or fewer"
            " Gaussians (a smaller --preset). The last checkpoint is untouched.",
        ) from error


def _used() -> str:
    """How full the card is, in brackets; empty where there is none."""
    if not torch.cuda.is_available():
        return ""
    free, total = torch.cuda.mem_get_info()
    ours = torch.cuda.max_memory_allocated()
    return f" ({total / GIB:.1f} GiB, {free / GIB:.1f} free, {ours / GIB:.1f} at most used by this)"
