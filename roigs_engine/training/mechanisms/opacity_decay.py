"""Opacity decay (Han et al. 2024; there it is the same in every step)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ...model.roi import OrientedBox
from ...model.scene import PosedImage
from ..config import Mechanism, PlannedViews, TrainConfig, limited
from ..running import Running
from .masked_steps import MaskedSteps
from .spaced_sh_rate import view_directions
from .surroundings_rate import outside_boxes

if TYPE_CHECKING:
    from torch import Tensor

    from ...model.gaussians import Gaussians
    from ..running import Training
    from ..state_reader import StateReader

DECAY_EVERY = 10  # steps between two decays at the least, or Adam could not keep up


@dataclass(frozen=True, kw_only=True)
class OpacityDecay(Mechanism):
    """Each time the photos have gone round, all Gaussians lose a little opacity.

    A photo that shows a Gaussian gives it back what it lost; what no photo needs fades, so that few
    photos leave less in the air (docs/method.md, "Opacity decay"). Of photos from one side, decay
    gains little, and fades plain surroundings (`one_sided`; ours).

    Earns: +0.10 dB in the silhouettes, +0.20 dB in images. Draft, six boxes of kumamon, flowerpot
        and the demo, two seeds (notebook/leave_one_out.md). `one_sided`: +0.28 dB in the
        silhouettes, −0.08 dB on objects, +0.34 dB in images (marginal; eight arcs of 16 and 24
        photos of flowerpot and kumamon, one seed each; notebook/opacities.md).

    Attributes:
        share: of its opacity that each Gaussian loses in a decay.
        outside_share: that of Gaussians outside the boxes; None: the same.
        one_sided: if the photos spread by less than this angle around the boxes, degrees
            (`view_spread`), `outside_share` is lowered to `share` times the share of whole photos:
            what is outside decays as often as these come round. 0: never.
    """

    name: ClassVar[str] = "opacity_decay"

    share: float = limited(0.025, least=0, below=1)
    outside_share: float | None = limited(None, least=0, below=1)
    one_sided: float = limited(0.0, least=0, most=90)

    def check(self, config: TrainConfig) -> None:
        """As usual; the rule for what is outside needs masks."""
        super().check(config)
        if self.one_sided or self.outside_share is not None:
            config.of(MaskedSteps, self)

    def planned(self, config: TrainConfig, views: PlannedViews) -> TrainConfig:
        if not self.one_sided:
            return config
        spread = max(view_spread(views.seen(roi), roi) for roi in views.rois)
        lower = self.share * (1 - (1 - 1 / config.of(MaskedSteps).full_every))
        decided = replace(self, one_sided=0.0)
        if spread < self.one_sided:
            decided = replace(decided, outside_share=min(lower, self.outside_share or lower))
        return config.using(decided)

    def begin(self, config: TrainConfig, training: Training) -> Running:
        return _Running(self, config.steps, training)

    def check_state(self, state: StateReader) -> None:
        rows = {} if self.outside_share is None else {"outside": state.rows}
        state.tensors(rows, flags=True)


class _Running(Running):
    def __init__(self, settings: OpacityDecay, steps: int, training: Training) -> None:
        self._settings, self._steps, self._rois = settings, steps, training.data.rois
        self._every = max(len(training.data.images), DECAY_EVERY)
        if settings.outside_share is not None:
            self.kept = ("outside",)
            self.outside = outside_boxes(training.gaussians, self._rois)

    def is_due(self, step: int) -> bool:
        """Not after the last step, as no photo could give back what is needed."""
        return step < self._steps and step % self._every == 0

    def after_step(self, training: Training) -> None:
        share, outside_share = self._settings.share, self._settings.outside_share
        shares: float | Tensor = share
        if outside_share is not None:
            shares = self.outside.double().fill_(share).masked_fill_(self.outside, outside_share)
        decay_opacities(training.gaussians.logit_opacities, shares)

    def follow(self, rows: Tensor, gaussians: Gaussians) -> None:
        if self._settings.outside_share is not None:
            self.outside = outside_boxes(gaussians, self._rois)


def decay_opacities(logit_opacities: Tensor, share: float | Tensor) -> None:
    """Lower (N,) opacities in place by a share of what they are: one in [0, 1), or (N,)."""
    import torch

    # logit(d o) = log d - log(1 - d + exp(-x)) for the opacity o = 1 / (1 + exp(-x))
    shares = torch.as_tensor(share, dtype=torch.float64, device=logit_opacities.device)
    lost, kept = (logs.to(logit_opacities) for logs in (shares.log(), torch.log1p(-shares)))
    logit_opacities.copy_(kept - torch.logaddexp(lost, -logit_opacities))


def view_spread(images: Sequence[PosedImage], roi: OrientedBox) -> float:
    """How far the photos spread around their mean direction, seen from the box's centre, degrees.

    It is the angle whose cosine is the length of the mean of the directions' unit vectors: 0 if all
    photos are in one direction, 90 if they are all around. A ring of photos at an elevation of 30
    degrees has 60, a third of that ring 30. 0 without photos.
    """
    if not images:
        return 0.0
    length = float(np.linalg.norm(view_directions(images, roi).mean(axis=0)))
    return math.degrees(math.acos(min(1.0, length)))
