"""Steps that the CPU has queued on a GPU before it knows whether they could be done there."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

import torch
from torch import Tensor

from ..cuda.pair_buffers import pair_buffers_on
from ..rasterize.inputs import BackwardStep
from .optimizer import VisibleAdam


class StepsAhead:
    """The steps since the last one that is known to be done; on the CPU there are none.

    A step whose view has more pairs than its buffer holds has changed nothing on the GPU, nor have
    those after it (`cuda.pair_buffers`). They must be done again, in order.
    """

    def __init__(self, device: torch.device) -> None:
        self._buffers = pair_buffers_on(device)
        self._losses: dict[int, Tensor] = {}

    def backward_step(
        self, optimizer: VisibleAdam, step: int, view: Hashable
    ) -> BackwardStep | None:
        """The optimizer's step for the backward pass; `view` is that of `PairBuffers.buffer`."""
        taken = optimizer.backward_step
        if taken is None or self._buffers is None:
            return taken
        return replace(taken, pair_buffer=self._buffers.buffer(step, view))

    def begin(self, step: int, loss: Tensor) -> None:
        """A step begins; `loss`: the running loss in front of it."""
        if self._buffers is not None:
            self._losses[step] = loss

    def first_void(self, *, wait: bool) -> tuple[int, Tensor] | None:
        """The first step to do again, and the running loss in front of it; None: none is known.

        Args: `wait`: until it is known of all steps.
        """
        if self._buffers is None:
            return None
        step = self._buffers.first_void(wait=wait)
        found = None if step is None else (step, self._losses[step])
        if wait or found is not None:
            self._losses.clear()
        return found

    def grow(self, before: int, after: int) -> None:
        """The model has another number of Gaussians."""
        if self._buffers is not None:
            self._buffers.grow(after / max(before, 1))
