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

MARGIN = 1.25  # of the number at the last visit: models change little between visits
LEAST_MARGIN = 4096  # pairs

Number = Callable[[bool], int | None]
"""A number on its way from the GPU: None before it is there, unless the argument says to wait.

It is given once.
"""


class ArrivingNumbers:
    """Copies scalars of a GPU to pinned memory, in the order of its queue; nobody waits."""

    def __init__(self) -> None:
        # Pinned memory is dear to get: a step would take a tenth of a millisecond longer.
        self._free: list[Tensor] = []

    def __call__(self, value: Tensor) -> Number:
        """Start to copy a () int64."""
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

    capacity: int | None  # pairs that it holds; None: the view is new, wait for the number
    void: Tensor  # () bool on the GPU, whether this view or an earlier one has too many
    report: Callable[[Tensor | int], None]
    """Gets the number of pairs that were counted: on the GPU, or read if `capacity` is None."""


class PairBuffers:
    """The buffers of a stage's views; `read` starts to read a () int64 of the device."""

    def __init__(
        self, device: torch.device, read: Callable[[Tensor], Number] | None = None
    ) -> None:
        self._read = read or ArrivingNumbers()
        self._void = torch.zeros((), dtype=torch.bool, device=device)
        self._needed: dict[Hashable, int] = {}
        self._coming: deque[tuple[int, Hashable, int, Number]] = deque()

    def buffer(self, step: int, view: Hashable) -> PairBuffer:
        """The buffer for a view, whose name says all that changes its pairs beside the model."""
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
        """The first step that must be done again, if any is known; later ones are forgotten.

        With `wait`, the GPU has counted the pairs of all views.
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
        """Expect so many times the pairs: there are more Gaussians."""
        for view, needed in self._needed.items():
            self._needed[view] = int(max(factor, 1.0) * needed)


def pair_buffers_on(device: torch.device) -> PairBuffers | None:
    """The buffers for training on a device; None on the CPU, which makes its own."""
    return PairBuffers(device) if device.type == "cuda" else None
