"""Sends values to a GPU without waiting for it."""

from __future__ import annotations

import functools

import torch
from torch import Tensor


def sent(tensor: Tensor, device: torch.device) -> Tensor:
    """The tensor on `device`. To a GPU it is copied through pinned memory, in the GPU's queue.

    `tensor.to(device)` would wait until the GPU has done all that is in its queue.
    """
    if device.type == "cpu" or tensor.device.type != "cpu":
        return tensor.to(device)
    return tensor.pin_memory().to(device, non_blocking=True)


@functools.lru_cache(maxsize=4096)
def number(value: float, device: torch.device) -> Tensor:
    """A float32 scalar on `device`, filled in there: nothing is copied. It must not be changed."""
    return torch.full((), value, dtype=torch.float32, device=device)
