"""Floater pruning: removes Gaussians in the air at the end of a stage (ours)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ...context import Context
from ...requests.choices import MIN_VIEWS
from ..config import Mechanism, TrainConfig, limited
from ..running import Running

if TYPE_CHECKING:
    from torch import Tensor

    from ..running import Training


@dataclass(frozen=True, kw_only=True)
class FloaterPruning(Mechanism):
    """Removes Gaussians that photos cannot judge (`training.floaters`).

    Earns: +0.06 dB in the silhouettes (marginal): validation photos hardly show what it is for,
        views between the photos. Draft, six boxes of kumamon, flowerpot and the demo, two seeds
        (notebook/leave_one_out.md).

    Attributes:
        min_views: of Gaussians before the boxes or the scene, those that fewer photos show go.
    """

    name: ClassVar[str] = "floater_pruning"

    min_views: int = limited(MIN_VIEWS, least=1)

    def begin(self, config: TrainConfig, training: Training) -> Running:
        return _Running(self.min_views)


class _Running(Running):
    def __init__(self, min_views: int) -> None:
        self._min_views = min_views

    def end(self, training: Training, context: Context) -> bool:
        from ..floaters import floaters

        def search() -> Tensor:
            model, data = training.gaussians, training.data
            return floaters(model, data.images, data.rois, data.points, self._min_views, context)

        return training.prune(context, "floaters", search)
