"""Steps on the boxes' silhouettes alone (ours, docs/method.md; the paper uses whole photos)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from ...selection.split import in_even_share
from ..config import Mechanism, PlannedViews, TrainConfig, limited, planned, with_steps
from ..photo_order import evenly_spaced
from ..running import Running
from .density_control import DensityControl

if TYPE_CHECKING:
    from ..loss_masks import LossMask, LossMasks
    from ..running import Training

MOST_MEASURED = 100  # photos for which the masks' share is measured: thousands would take a minute


@dataclass(frozen=True, kw_only=True)
class MaskedSteps(Mechanism):
    """Most steps use the masks of photos that see a box (`loss_masks`), the others whole photos.

    The Scene-GS stage has already trained the background. Masked steps are faster, and their
    gradients go into the boxes.

    Earns: +0.38 dB in the silhouettes, −0.27 dB in whole images by masks; +0.34 and +0.12 dB by
        weights of photos. Draft, six boxes of kumamon, flowerpot and the demo, two seeds
        (notebook/leave_one_out.md). +0.04 and +0.35 dB by steps given back, one seed
        (notebook/steps_and_budgets.md).

    Attributes:
        whole_share: share of the steps that use a whole photo, drawn from all photos.
        reinvested: share of the pixels saved by masks that is used for more steps on whole photos.
        view_weighting: loss weights of masks (`LossMasks`). With 0, a pixel weighs as much as in a
            whole photo. With 1, all photos weigh the same, for any size of the boxes in them. Up to
            2, photos with small boxes weigh more.
        seeing: row numbers of the photos that see a box.
    """

    name: ClassVar[str] = "masked_steps"
    uses_object_masks: ClassVar[bool] = True

    whole_share: float = limited(1 / 3, least=0, below=1)
    reinvested: float = limited(0.0, least=0, most=1)
    view_weighting: float = limited(0.0, least=0, most=2)
    seeing: tuple[int, ...] = planned(())

    def planned(self, config: TrainConfig, views: PlannedViews) -> TrainConfig:
        """Add the photos that see a box, and the reinvested steps."""
        from ..loss_masks import LossMasks

        seeing = views.rows_seeing
        masked = (1 - self.whole_share) * config.steps
        whole = self.whole_share * config.steps
        if self.reinvested and seeing:
            some = evenly_spaced(seeing, MOST_MEASURED)
            masks = LossMasks(views.images, views.rois, some, context=views.context)
            whole += self.reinvested * (1 - masks.shares(some).mean()) * masked
        share = whole / (masked + whole)
        longer = with_steps(config, round(masked + whole))
        # Steps that are given back refine: densification ends when it would have.
        longer = longer.using(*config.chosen(DensityControl))
        return longer.using(replace(self, whole_share=share, seeing=seeing))

    def begin(self, config: TrainConfig, training: Training) -> Running:
        from ..loss_masks import LossMasks

        data = training.data
        given = data.rois, self.seeing, data.device, self.view_weighting, training.context
        return _Running(self.whole_share, LossMasks(data.images, *given))


class _Running(Running):
    def __init__(self, whole_share: float, masks: LossMasks) -> None:
        self._whole_share, self._masks = whole_share, masks

    def mask(self, step: int, photo: int) -> LossMask | None:
        """Return the photo's mask; None if the step uses a whole photo, or it sees no box."""
        return None if in_even_share(step, self._whole_share) else self._masks[photo]
