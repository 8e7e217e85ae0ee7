"""Steps that the CPU has queued on a GPU before it knows whether they could be done there."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

import torch
from torch import Tensor

from ..cuda.rooms import rooms_on
from ..rasterize.inputs import BackwardStep
from .optimizer import VisibleAdam


class StepsAhead:
    """The steps since the last one that is known to be done; on the CPU there are none.

    A step that its view had no room for has changed nothing on the GPU, nor have those after it
    (`cuda.rooms`). They must be done again, in order.
    """

    def __init__(self, device: torch.device) -> None:
        self._rooms = rooms_on(device)
        self._losses: dict[int, Tensor] = {}

    def backward_step(
        self, optimizer: VisibleAdam, step: int, view: Hashable
    ) -> BackwardStep | None:
        """The optimizer's step for the backward pass; `view` names what `Rooms.room` asks for."""
        taken = optimizer.backward_step
        if taken is None or self._rooms is None:
            return taken
        return replace(taken, room=self._rooms.room(step, view))

    def begin(self, step: int, loss: Tensor) -> None:
        """A step begins; `loss`: the running loss in front of it."""
        if self._rooms is not None:
            self._losses[step] = loss

    def first_void(self, *, wait: bool) -> tuple[int, Tensor] | None:
        """The first step to do again, and the running loss in front of it; None: none is known.

        Args: `wait`: until it is known of all steps.
        """
        if self._rooms is None:
            return None
        step = self._rooms.first_void(wait=wait)
        found = None if step is None else (step, self._losses[step])
        if wait or found is not None:
            self._losses.clear()
        return found

    def grow(self, before: int, after: int) -> None:
        """The model has another number of Gaussians."""
        if self._rooms is not None:
            self._rooms.grow(after / max(before, 1))
