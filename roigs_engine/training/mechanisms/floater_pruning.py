"""Floater pruning: removes Gaussians in the air before the last steps of a stage (ours)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ...context import Context
from ...requests.choices import MIN_VIEWS
from ..config import Mechanism, TrainConfig, limited
from ..running import Running
from .model_averaging import ModelAveraging

if TYPE_CHECKING:
    from torch import Tensor

    from ..running import Training
    from ..state_reader import StateReader


@dataclass(frozen=True, kw_only=True)
class FloaterPruning(Mechanism):
    """Removes floaters (`training.floaters`) before the averaging.

    Some of them contribute light to a few photos. The averaged steps make up for it.

    Earns: +0.06 dB in the silhouettes with all photos (draft, six boxes of kumamon, flowerpot and
        the demo, two seeds; notebook/leave_one_out.md), and up to 15 dB on single photos with few
        to train on (notebook/few_photos.md): it is for views between the photos.

    Attributes:
        min_views: Gaussians in front of the boxes or the scene are removed if fewer photos show
            them.
    """

    name: ClassVar[str] = "floater_pruning"

    min_views: int = limited(MIN_VIEWS, least=1)

    def begin(self, config: TrainConfig, training: Training) -> Running:
        averaging = config.get(ModelAveraging)
        before = config.steps - (averaging.steps if averaging else 0)
        return _Running(self.min_views, before if before > 0 else config.steps)

    def check_state(self, state: StateReader) -> None:
        state.flag("done")
        state.tensors({}, besides=("done",))


class _Running(Running):
    kept = ("done",)

    def __init__(self, min_views: int, due: int) -> None:
        self._min_views, self._due = min_views, due
        self.done = False

    def between_steps(self, training: Training, context: Context) -> bool:
        if self.done or training.step < self._due or not training.settled():
            return True
        self.done = self._prune(training, context)
        return self.done

    def end(self, training: Training, context: Context) -> bool:
        """Prune now in a stage without averaging, or that averages all its steps."""
        return self.done or self._prune(training, context)

    def _prune(self, training: Training, context: Context) -> bool:
        from ..floaters import floaters

        def search() -> Tensor:
            model, data = training.gaussians, training.data
            return floaters(model, data.images, data.rois, data.points, self._min_views, context)

        return training.prune(context, "floaters", search)
