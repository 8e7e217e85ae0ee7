"""Helpers of the training loop: callbacks, threads, full GPU memory, steps queued on a GPU."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace

import torch
from torch import Tensor

from ..cuda.device import explain_out_of_memory, smaller_side
from ..cuda.pair_buffers import pair_buffers_on
from ..model.scene import PosedImage
from ..rasterize.inputs import BackwardStep
from .optimizer import VisibleAdam


class PeriodicCallback:
    """Calls a function every `every` seconds of training; takes at most a tenth of the time.

    With `every` 0, it is never called.
    """

    def __init__(self, every: float, call: Callable[[], None]) -> None:
        self._every, self._call = every, call
        self._due: float | None = None

    def call_if_due(self, seconds: float) -> float:
        """Call it if it is due after `seconds` of training; return the seconds it took."""
        if self._every <= 0:
            return 0.0
        if self._due is None:
            self._due = seconds + self._every
        if seconds < self._due:
            return 0.0
        began = time.perf_counter()
        self._call()
        spent = time.perf_counter() - began
        self._due = seconds + max(self._every, 9 * spent)
        return spent


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Limit torch to one thread: its threads and the kernels' would compete for the same cores.

    torch's share of a training step is small, so more threads would cost more than they gain.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def explained_full_memory(
    images: Sequence[PosedImage], now: Callable[[], tuple[int, int]]
) -> AbstractContextManager[None]:
    """Turn torch's error into a GpuMemoryError; `now` returns the step and number of Gaussians."""
    cameras = [image.camera for image in images]
    width, height = max(c.width for c in cameras), max(c.height for c in cameras)

    def doing() -> str:
        step, gaussians = now()
        return f"step {step}, {gaussians:,} Gaussians, photos of up to {width}x{height}"

    return explain_out_of_memory(
        doing,
        "Close other programs that use the GPU, or train with smaller photos"
        f" (--max-side {smaller_side(width, height)}) or fewer Gaussians (a smaller"
        " --preset). --device cpu resumes from the last checkpoint.",
    )


class StepsAhead:
    """The steps since the last one known to be done; on the CPU there are none.

    If a step's view has more pairs than its buffer holds, the step and those after it change
    nothing on the GPU (`cuda.pair_buffers`). They must be done again, in order.
    """

    def __init__(self, device: torch.device) -> None:
        self._buffers = pair_buffers_on(device)
        self._losses: dict[int, Tensor] = {}

    def backward_step(self, optimizer: VisibleAdam, step: int, view: Hashable) -> BackwardStep:
        """Return the optimizer's step for the backward pass; `view` is for `PairBuffers.buffer`."""
        taken = optimizer.backward_step
        if self._buffers is None:
            return taken
        return replace(taken, pair_buffer=self._buffers.buffer(step, view))

    def begin(self, step: int, loss: Tensor) -> None:
        """Record that a step begins; `loss` is the running loss before it."""
        if self._buffers is not None:
            self._losses[step] = loss

    def first_void(self, *, wait: bool) -> tuple[int, Tensor] | None:
        """Return the first step to do again, and the running loss before it; None without one.

        With `wait`, this waits until all steps are known.
        """
        if self._buffers is None:
            return None
        step = self._buffers.first_void(wait=wait)
        found = None if step is None else (step, self._losses[step])
        if wait or found is not None:
            self._losses.clear()
        return found

    def grow(self, before: int, after: int) -> None:
        """Grow the buffers with the model's number of Gaussians."""
        if self._buffers is not None:
            self._buffers.grow(after / max(before, 1))
