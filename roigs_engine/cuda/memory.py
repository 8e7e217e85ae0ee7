"""Explains the error when GPU memory is full."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch

from ..errors import GpuMemoryError

GIB = 1 << 30
SHARE_OF_PHOTOS = 4  # photos may take 1/4 of the free GPU memory


def card_memory(device: torch.device) -> tuple[int, int]:
    """Bytes that this process can still take of a GPU's memory, and all that it has."""
    free, total = torch.cuda.mem_get_info(device)
    cached = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return free + cached, total


@contextmanager
def explain_out_of_memory(doing: Callable[[], str], advice: Callable[[], str]) -> Iterator[None]:
    """Turn torch's out-of-memory error into one line.

    Args:
        doing: describes the work with its numbers, for the message.
        advice: what to change, for the hint.

    Raises:
        GpuMemoryError: the GPU memory is full.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        message = f"The GPU memory is full{_used()}: {doing()}."
        raise GpuMemoryError(message, advice()) from error


def smaller_side(width: int, height: int) -> int:
    """A longest side, in pixels, to suggest instead of that of (width, height)."""
    return max(64, max(width, height) * 3 // 4)


def _used() -> str:
    """The GPU memory in use, in parentheses; empty without a GPU."""
    if not torch.cuda.is_available():
        return ""
    free, total = torch.cuda.mem_get_info()
    ours = torch.cuda.max_memory_allocated()
    return f" ({total / GIB:.1f} GiB, {free / GIB:.1f} free, at most {ours / GIB:.1f} used by this)"
