"""Buffers for the (Gaussian, tile) pairs of a view, sized without waiting for the GPU.

Only the GPU knows how many pairs a view has. If a step's buffer is too small, this view and all
later ones are *void*: they draw nothing and change nothing. The CPU learns this some steps later,
and repeats the void steps with larger buffers (docs/cuda.md).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import torch
from torch import Tensor

MARGIN = 1.25  # x the pairs in the view's last step; a model changes little between two
LEAST_MARGIN = 4096  # pairs

Number = Callable[[bool], int | None]
"""Returns a number that the GPU sends: None if it has not arrived; with True, waits for it.

After it has returned a number, it must not be called again.
"""


class ArrivingNumbers:
    """Copies scalars from a GPU to pinned memory, in the order of its queue, without waiting."""

    def __init__(self) -> None:
        # Reuse pinned memory: allocating it would take 0.1 ms in each step.
        self._free: list[Tensor] = []

    def __call__(self, value: Tensor) -> Number:
        """Start the copy of a () int64."""
        host = self._free.pop() if self._free else torch.empty((), dtype=torch.int64).pin_memory()
        host.copy_(value, non_blocking=True)
        arrived = torch.cuda.current_stream(value.device).record_event()

        def ask(wait: bool) -> int | None:
            if wait:
                arrived.synchronize()
            elif not arrived.query():
                return None
            number = int(host)
            self._free.append(host)
            return number

        return ask


@dataclass(frozen=True, kw_only=True)
class PairBuffer:
    """The buffer for one view of one step."""

    capacity: int | None  # most pairs; None: the view is new, so wait for the number
    void: Tensor  # () bool on the GPU, whether this view or an earlier one has too many pairs
    report: Callable[[Tensor | int], None]
    """Takes the number of pairs: a tensor on the GPU, or an int if `capacity` is None."""


class PairBuffers:
    """The buffers of a stage's views; `read` starts to read a () int64 from the device."""

    def __init__(
        self, device: torch.device, read: Callable[[Tensor], Number] | None = None
    ) -> None:
        self._read = read or ArrivingNumbers()
        self._void = torch.zeros((), dtype=torch.bool, device=device)
        self._needed: dict[Hashable, int] = {}
        self._coming: deque[tuple[int, Hashable, int, Number]] = deque()

    def buffer(self, step: int, view: Hashable) -> PairBuffer:
        """The buffer for a view. `view` identifies everything but the model that affects pairs."""
        needed = self._needed.get(view)
        capacity = None if needed is None else max(int(MARGIN * needed), needed + LEAST_MARGIN)

        def report(total: Tensor | int) -> None:
            if capacity is None:
                self._needed[view] = int(total)
                return
            assert isinstance(total, Tensor)
            torch.logical_or(self._void, total > capacity, out=self._void)
            self._coming.append((step, view, capacity, self._read(total)))

        return PairBuffer(capacity=capacity, void=self._void, report=report)

    def first_void(self, *, wait: bool) -> int | None:
        """The first step that must be repeated, if any is known; later reports are dropped.

        `wait`: wait until the GPU has counted the pairs of all views.
        """
        while self._coming:
            step, view, capacity, number = self._coming[0]
            total = number(wait)
            if total is None:
                return None
            self._coming.popleft()
            self._needed[view] = total
            if total > capacity:
                self._coming.clear()
                self._void.zero_()
                return step
        return None

    def grow(self, factor: float) -> None:
        """Expect `factor` times as many pairs, because there are more Gaussians."""
        for view, needed in self._needed.items():
            self._needed[view] = int(max(factor, 1.0) * needed)


def pair_buffers_on(device: torch.device) -> PairBuffers | None:
    """The buffers for training on a device; None on the CPU, which allocates its own."""
    return PairBuffers(device) if device.type == "cuda" else None
