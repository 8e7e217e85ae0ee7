"""Coarse to fine: the first steps of a stage on photos of half the size (ours)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..config import Mechanism, TrainConfig, share_of_steps
from ..photo_order import is_whole
from .masked_steps import MaskedSteps


@dataclass(frozen=True, kw_only=True)
class CoarseToFine(Mechanism):
    """The first steps use photos of half the size: they take half the time.

    What they lack is learned after them.

    Earns: −0.06 dB in the silhouettes by `until`, +0.01 dB by `whole_until` (both marginal).
        Draft, six boxes of kumamon, flowerpot and the demo, two seeds
        (notebook/leave_one_out.md). 7 to 8 % less CPU time by the second (kumamon, one seed;
        notebook/sampling.md).

    Attributes:
        until: steps before this one are small.
        whole_until: steps before this one that use a whole photo are small, too: what is beside the
            boxes needs no more.
    """

    name: ClassVar[str] = "coarse_to_fine"

    until: int = share_of_steps(0)
    whole_until: int = share_of_steps(0)

    @property
    def has_small(self) -> bool:
        return max(self.until, self.whole_until) > 0

    def is_small(self, step: int, config: TrainConfig) -> bool:
        masks = config.get(MaskedSteps)
        whole = masks is None or is_whole(step, masks.full_every)
        return step < (max(self.until, self.whole_until) if whole else self.until)
