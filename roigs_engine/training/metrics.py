"""Training metrics: loss and PSNR for the progress; checks for NaN and outlier photos.

Losses stay on their device. Every `CHECK_EVERY` steps, the checks read them and the parameters.
Between checks, the CPU does not wait for a GPU.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from ..errors import TrainingError
from ..formats.text import counted

PSNR_EVERY = 50  # steps
RECENT = 0.98  # weight of the past in the running loss


class TrainingMetrics:
    """The running loss and PSNR for the progress; on the device until they are read.

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
        """Whether there is a new PSNR to `read`."""
        return self._error is not None

    def observe(
        self, step: int, loss: Tensor, pictures: tuple[Tensor, Tensor], weights: Tensor | None
    ) -> None:
        """Add a step's loss and, every `PSNR_EVERY` steps, the error of its picture.

        `pictures` are the render, (H, W, 3) in [0, 1], and the photo, (H, W, 3) uint8.
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

    def take_back(self, loss: Tensor) -> None:
        """Restore this running loss, because the steps since are repeated."""
        self.loss, self._error = loss, None


CHECK_EVERY = 100  # steps; at least as often as Gaussians are added
VISITS = 5  # number of a photo's last losses that count; with fewer, it is not judged
FEWEST_PHOTOS = 8  # with fewer photos, none is judged
# An outlier is DEVIATIONS standard deviations above the median, estimated from the median deviation
# (Iglewicz and Hoaglin 1993 use 3.5; photos differ more), and at least TIMES the median.
DEVIATIONS, TIMES = 6.0, 1.5
NAMED = 3  # most outliers that a warning names
HINT = (
    "Check the photos named in warnings, and the model's scale. The last good checkpoint is kept;"
    " the same command resumes from it."
)


class Health:
    """The checks of one stage. They do not change the training.

    Args: `photos` are the names of the stage's photos; `record_loss` gets positions in this list.
    """

    def __init__(self, photos: Sequence[str]) -> None:
        self._photos = list(photos)
        self._new: list[tuple[int, int, Tensor]] = []
        self._recent: dict[int, deque[float]] = {}

    def record_loss(self, step: int, photo: int, loss: Tensor) -> None:
        """Keep the loss of a step, a scalar tensor, without reading its value."""
        self._new.append((step, photo, loss))

    def forget(self, step: int) -> None:
        """Drop the losses of this and later steps, which are done again."""
        self._new = [record for record in self._new if record[0] < step]

    def check(
        self, step: int, parameters: Mapping[str, Tensor], skipped_rows: int | Tensor
    ) -> None:
        """Check the losses since the last check, the gradients and the parameters.

        Args:
            step: steps done.
            parameters: name -> (N, ...) tensor.
            skipped_rows: `VisibleAdam.skipped_rows`.

        Raises:
            TrainingError: a loss, a gradient or a parameter is NaN or Inf.
        """
        self._read_losses()
        since = f"between step {max(step - CHECK_EVERY, 0)} and step {step}"
        if int(skipped_rows):
            raise TrainingError(f"Training diverged: NaN or Inf in the gradients {since}.", HINT)
        for name, tensor in parameters.items():
            # One pass over memory: a sum is finite only if all values are.
            if bool(tensor.detach().sum().isfinite()):
                continue
            rows = int((~tensor.detach().isfinite()).reshape(len(tensor), -1).any(dim=1).sum())
            if rows:
                text = f"Training diverged: NaN or Inf in `{name}` of {rows} Gaussians {since}."
                raise TrainingError(text, HINT)

    def _read_losses(self) -> None:
        new, self._new = self._new, []
        losses = torch.stack([loss for _, _, loss in new]).tolist() if new else []
        for (step, photo, _), loss in zip(new, losses, strict=True):
            if not np.isfinite(loss):
                name = self._photos[photo]
                raise TrainingError(
                    f"Training diverged: the loss was {loss} at step {step}, photo '{name}'.", HINT
                )
            self._recent.setdefault(photo, deque(maxlen=VISITS)).append(loss)

    def outliers(self, named: set[str] | None = None) -> str:
        """Return a warning about photos whose loss stays far above the others', or an empty string.

        Args: `named` has photos to leave out; the new outliers are added to it.
        """
        self._read_losses()
        # The smallest of its last losses: a photo must be bad on every visit.
        least = {k: min(v) for k, v in self._recent.items() if len(v) == VISITS}
        if len(least) < FEWEST_PHOTOS:
            return ""
        values = np.array(list(least.values()))
        middle = float(np.median(values))
        spread = 1.4826 * float(np.median(np.abs(values - middle)))
        limit = max(middle + DEVIATIONS * spread, TIMES * middle)
        named = set() if named is None else named
        worst = sorted((k for k in least if least[k] > limit), key=lambda k: -least[k])
        worst = [k for k in worst if self._photos[k] not in named]
        if not worst:
            return ""
        named.update(self._photos[k] for k in worst)
        names = ", ".join(f"'{self._photos[k]}'" for k in worst[:NAMED])
        more = f" and {len(worst) - NAMED} more" if len(worst) > NAMED else ""
        return (
            f"{counted(len(worst), 'photo')} fit worse than the others: {names}{more} (loss up "
            f"to {least[worst[0]]:.3f}, median {middle:.3f}). Normal for close-ups; otherwise "
            "check them."
        )
