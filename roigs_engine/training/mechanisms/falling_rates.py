"""Learning rates that fall together over a stage (ours, for `adapt`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ..config import Mechanism, TrainConfig, limited
from ..running import Running

if TYPE_CHECKING:
    from torch import Tensor

    from ..running import Training


@dataclass(frozen=True, kw_only=True)
class FallingRates(Mechanism):
    """All learning rates fall exponentially, in addition to the positions' own decay.

    Earns: not measured.

    Attributes:
        last: factor on the rates at the end of the stage.
    """

    name: ClassVar[str] = "falling_rates"

    last: float = limited(0.1, above=0, most=1)

    def begin(self, config: TrainConfig, training: Training) -> Running:
        return _Running(self.last, config.steps, training)


class _Running(Running):
    def __init__(self, last: float, steps: int, training: Training) -> None:
        self._last, self._steps, self._training = last, steps, training

    def row_rates(self, *, whole: bool) -> Tensor | None:
        factor = self._last ** (self._training.step / self._steps)
        import torch

        count, device = len(self._training.optimizer), self._training.data.device
        return torch.full((count,), factor, dtype=torch.float32, device=device)
