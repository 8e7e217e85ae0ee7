"""Opacity decay (Han et al. 2024, who decay by the same amount in every step)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ..config import Mechanism, TrainConfig, limited
from ..running import Running

if TYPE_CHECKING:
    from torch import Tensor

    from ..running import Training

DECAY_EVERY = 10  # least steps between two decays, so that Adam can keep up


@dataclass(frozen=True, kw_only=True)
class OpacityDecay(Mechanism):
    """After each pass over the photos, all Gaussians lose a little opacity.

    Photos that show a Gaussian restore its opacity. Gaussians that no photo needs fade, which
    leaves fewer floaters if there are few photos (docs/method.md, "Opacity decay").

    Earns: +0.10 dB in the silhouettes, +0.20 dB in images. Draft, six boxes of kumamon, flowerpot
        and the demo, two seeds (notebook/leave_one_out.md).

    Attributes:
        share: of a Gaussian's opacity lost in each decay.
    """

    name: ClassVar[str] = "opacity_decay"

    share: float = limited(0.025, least=0, below=1)

    def begin(self, config: TrainConfig, training: Training) -> Running:
        return _Running(self.share, config.steps, len(training.data.images))


class _Running(Running):
    def __init__(self, share: float, steps: int, photos: int) -> None:
        self._share, self._steps = share, steps
        self._every = max(photos, DECAY_EVERY)

    def is_due(self, step: int) -> bool:
        """Not due after the last step, because no photo could restore necessary opacity."""
        return step < self._steps and step % self._every == 0

    def after_step(self, training: Training) -> None:
        decay_opacities(training.gaussians.logit_opacities, self._share)


def decay_opacities(logit_opacities: Tensor, share: float) -> None:
    """Lower (N,) opacities in place by a share of their values, in [0, 1)."""
    import torch

    # logit(d o) = log d - log(1 - d + exp(-x)) for the opacity o = 1 / (1 + exp(-x))
    shares = torch.as_tensor(share, dtype=torch.float64, device=logit_opacities.device)
    lost, kept = (logs.to(logit_opacities) for logs in (shares.log(), torch.log1p(-shares)))
    logit_opacities.copy_(kept - torch.logaddexp(lost, -logit_opacities))
