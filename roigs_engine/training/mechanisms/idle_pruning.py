"""Pruning by contribution: removes Gaussians that no training pixel shows (ROI-GS, sec. II-B)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ...errors import ConfigError
from ..config import Mechanism, TrainConfig, interval
from ..running import Running
from .masked_steps import MaskedSteps

if TYPE_CHECKING:
    from torch import Tensor

    from ...model.gaussians import Gaussians
    from ..running import Training
    from ..state_reader import StateReader

VISIBLE_WEIGHT = 1 / 255  # alpha x T below which a Gaussian cannot change an 8-bit pixel


@dataclass(frozen=True, kw_only=True)
class IdlePruning(Mechanism):
    """After a window of steps, removes Gaussians that stayed below 1/255 on all its pixels.

    Earns: not measured alone: part of the paper's method.

    Attributes:
        every: shortest window, in steps; a window includes every photo twice.
    """

    name: ClassVar[str] = "idle_pruning"

    every: int = interval(1000, least=1)

    def check(self, config: TrainConfig) -> None:
        """Refuse steps on masks: Gaussians outside the masks would be removed."""
        super().check(config)
        if config.get(MaskedSteps) is not None:
            raise ConfigError(
                f"{self.name} needs steps that use whole photos.",
                f"Leave out {self.name} or {MaskedSteps.name}.",
            )

    def begin(self, config: TrainConfig, training: Training) -> Running:
        return _Running(self, training)

    def check_state(self, state: StateReader) -> None:
        state.count("window", state.step)
        state.tensors({"weight": state.rows}, besides=("window",), least=0.0)


class _Running(Running):
    kept = ("window", "weight")
    needs_max_weight = True

    def __init__(self, settings: IdlePruning, training: Training) -> None:
        self._steps = max(settings.every, 2 * len(training.data.images))
        self.window = 0  # the step at which the current window began
        # (N,) largest alpha x T on any training pixel of the window; infinite for Gaussians added
        # in it, since some photos have not been drawn after that.
        gaussians = training.gaussians
        self.weight = gaussians.logit_opacities.detach().new_zeros(len(gaussians))

    def observe(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        assert max_weight is not None
        self.weight = self.weight.maximum(max_weight)

    def is_due(self, step: int) -> bool:
        return step - self.window >= self._steps

    def after_step(self, training: Training) -> None:
        from ..edits import unchanged

        keep = self.weight >= VISIBLE_WEIGHT
        if not bool(keep.all()):
            training.apply(unchanged(training.gaussians).keep(keep.nonzero()[:, 0]))
        self.weight.zero_()
        self.window = training.step

    def follow(self, rows: Tensor, gaussians: Gaussians) -> None:
        old = self.weight[rows.clamp(min=0)]
        self.weight = old.masked_fill(rows < 0, float("inf"))
