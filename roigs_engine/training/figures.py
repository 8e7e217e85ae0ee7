"""The loss and the PSNR that progress shows. They stay on the device until they are read."""

from __future__ import annotations

import torch
from torch import Tensor

from ..formats.events import Progress

PSNR_EVERY = 50  # steps
RECENT = 0.98  # weight of the past in the running loss


class Figures:
    """Running figures of a training.

    Attributes:
        loss: () running loss, NaN before the first step.
        psnr: running PSNR in dB, NaN before the first one is read.
    """

    def __init__(self, device: torch.device) -> None:
        self.loss = torch.full((), torch.nan, device=device)
        self.psnr = float("nan")
        self._error: Tensor | None = None

    @property
    def is_new(self) -> bool:
        """Whether there is a PSNR to `read`."""
        return self._error is not None

    def observe(
        self, step: int, loss: Tensor, pictures: tuple[Tensor, Tensor], weights: Tensor | None
    ) -> None:
        """Take a step's loss and, every `PSNR_EVERY` steps, the error of its picture.

        Args:
            step: its number.
            loss: () without gradient.
            pictures: the render, (H, W, 3) in [0, 1], and the photo, (H, W, 3) uint8.
            weights: (H, W) of the pixels; None: all equal.
        """
        self.loss = torch.where(self.loss.isnan(), loss, self.loss.lerp(loss, 1 - RECENT))
        if step % PSNR_EVERY:
            return
        error = (pictures[0].detach() - pictures[1] / 255.0).square().mean(dim=-1)
        if weights is None:
            self._error = error.mean()
        else:
            self._error = (error * weights).sum() / weights.sum().clamp(min=1)

    def read(self) -> None:
        """Add the last picture's PSNR, if it is new; waits for the device."""
        if self._error is None:
            return
        psnr = float(-10 * torch.log10(self._error.clamp(min=1e-10)))
        is_first = self.psnr != self.psnr
        self.psnr = psnr if is_first else 0.7 * self.psnr + 0.3 * psnr
        self._error = None

    def progress(
        self, stage: str, step: int, total: int, gaussians: int, seconds_left: float
    ) -> Progress:
        """The event that shows them, with where the stage is; waits for the device."""
        return Progress(
            stage=stage,
            step=step,
            total=total,
            loss=float(self.loss),
            psnr=self.psnr,
            gaussians=gaussians,
            seconds_left=seconds_left,
        )

    def take_back(self, loss: Tensor) -> None:
        """The running loss is this one again: the steps since are done anew."""
        self.loss, self._error = loss, None
