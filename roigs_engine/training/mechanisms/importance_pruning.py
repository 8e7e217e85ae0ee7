"""Importance pruning: Gaussians that the photos hardly show, when densification ends (ours)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ...context import Context
from ...errors import ConfigError
from ..config import Mechanism, TrainConfig
from ..running import Running
from .density_control import DensityControl
from .masked_steps import MaskedSteps

if TYPE_CHECKING:
    from torch import Tensor

    from ..running import Training
    from ..state_reader import StateReader


@dataclass(frozen=True, kw_only=True)
class ImportancePruning(Mechanism):
    """Removes the least important Gaussians, as many as the photos do not miss (`importance`).

    Earns: 29 % fewer Gaussians at 0.00 dB. Draft, six boxes of kumamon, flowerpot and the demo,
        two seeds (notebook/leave_one_out.md).

    Attributes:
        growth: largest share by which the photos' squared error may grow.
    """

    name: ClassVar[str] = "importance_pruning"

    growth: float = 0.05

    def check(self, config: TrainConfig) -> None:
        """Refuse stages that do not densify: they have no more than they need."""
        if not self.growth > 0:
            raise ConfigError(f"{self.name}: growth is {self.growth:g}.", "Use more than 0.")
        config.of(DensityControl, self)

    def acts(self, config: TrainConfig) -> bool:
        """If Gaussians were added, and steps follow."""
        return config.of(DensityControl).ends_within(config)

    def begin(self, config: TrainConfig, training: Training, context: Context) -> Running:
        """Nothing is pruned yet."""
        by_box = config.get(MaskedSteps) is not None
        return _Running(self.growth, config.of(DensityControl).until, by_box=by_box)

    def check_state(self, state: StateReader) -> None:
        """Whether it is done."""
        state.flag("done")
        state.tensors({}, besides=("done",))


class _Running(Running):
    def __init__(self, growth: float, due: int, *, by_box: bool) -> None:
        self._growth, self._due, self._by_box = growth, due, by_box
        self._done = False

    def between_steps(self, training: Training, context: Context) -> bool:
        """Prune once, when densification has ended; False if stopped."""
        if self._done or training.step < self._due or not training.settled():
            return True
        from ..importance import unimportant_gaussians

        def search() -> Tensor:
            data, photos = training.data, training.photos
            rois = data.rois if self._by_box else ()
            return unimportant_gaussians(
                training.gaussians, data, photos, self._growth, rois, context
            )

        self._done = training.prune(context, "Gaussians that the photos hardly show", search)
        return self._done

    def state_dict(self) -> dict[str, Any]:
        """Whether it is done."""
        return {"done": self._done}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a `state_dict`."""
        self._done = bool(state["done"])
