"""An optimizer's parameters and moments, kept on a GPU while only steps change them.

Then a step sends only the photo's gradient. Code that reads the tensors in main memory calls
`Resident.settle` first, and may change them. So the next step uses the tensors in main memory, and
only the step after it moves them to the GPU again. This avoids sending a model back and forth if it
is read after each step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from .program import Commands, Memory, Program

if TYPE_CHECKING:
    from torch import Tensor

NAMES = ("values", "exp_avg", "exp_avg_sq")


class Resident:
    """State that may be on a GPU.

    Attributes:
        is_newer: whether the state is on the GPU, and newer than the tensors.
    """

    def __init__(self, state: Callable[[], Sequence[Sequence[Tensor]]], *, stays: bool) -> None:
        """Begin with the state in main memory.

        Args:
            state: returns the tensors for each of `NAMES`: means, quats, scales, opacities, SH.
            stays: whether the first `hold` already moves the state to the GPU.
        """
        self._state, self._is_idle, self.is_newer = state, stays, False
        self.memory: Memory | None = None

    def hold(self, program: Program) -> bool:
        """Move the state to the GPU unless it was read since the last step; whether it is there."""
        if self.is_newer:
            return True
        if not self._is_idle:
            self._is_idle = True
            return False
        memory = self.memory
        if memory is None or memory.program is not program:
            memory = self.memory = Memory(program)
        for name, tensors in zip(NAMES, self._state(), strict=True):
            arrays = [tensor.detach().numpy() for tensor in tensors]
            sizes = {f"{name}_shapes": sum(a.nbytes for a in arrays[:4])}
            memory.need(**sizes, **{f"{name}_sh": arrays[4].nbytes})
            memory.write(f"{name}_shapes", *arrays[:4])
            memory.write(f"{name}_sh", arrays[4])
        self.is_newer = True
        return True

    def settle(self) -> None:
        """Bring the state back, to read and change it. Raises KernelError."""
        self._is_idle = False
        if not self.is_newer:
            return
        assert self.memory is not None
        with self.memory.program.explained("reading the model"):
            for name, tensors in zip(NAMES, self._state(), strict=True):
                self._read(f"{name}_shapes", tensors[:4])
                self._read(f"{name}_sh", tensors[4:])
        self.is_newer = False

    def _read(self, name: str, tensors: Sequence[Tensor]) -> None:
        assert self.memory is not None
        arrays = [tensor.detach().numpy() for tensor in tensors]
        (found,) = Commands(self.memory).read((name, sum(array.nbytes for array in arrays)))
        place = 0
        for array in arrays:
            array.reshape(-1).view("u1")[:] = found[place : place + array.nbytes]
            place += array.nbytes
