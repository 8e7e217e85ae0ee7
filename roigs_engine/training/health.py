"""Is training well? Numbers that are none, and photos that training cannot explain.

The loss of every step is kept where it was computed and read every so many steps, together with a
pass over the parameters: on a graphics card nothing waits for it in between.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from ..errors import TrainingError

CHECK_EVERY = 100  # steps; not less often than Gaussians are added
VISITS = 5  # the last ones of a photo; with fewer, nothing is said of it
FEWEST_PHOTOS = 8  # with fewer, nothing is said of any
# An outlier is so many standard deviations above the median, estimated from the median deviation
# (Iglewicz and Hoaglin 1993 take 3.5; photos differ in what they show), and so many times as large.
DEVIATIONS, TIMES = 6.0, 1.5
HINT = (
    "Look at the photos that were named in warnings, and at the model's scale. The last good"
    " checkpoint is kept; the same command goes on from it."
)


class Health:
    """What is watched during one stage. Nothing in it decides how training goes on.

    Args: `photos`: names of the stage's photos, by the numbers that `saw` is given.
    """

    def __init__(self, photos: Sequence[str]) -> None:
        self._photos = list(photos)
        self._new: list[tuple[int, int, Tensor]] = []
        self._recent: dict[int, deque[float]] = {}

    def record_loss(self, step: int, photo: int, loss: Tensor) -> None:
        """Keep the loss, a scalar tensor, of a step."""
        self._new.append((step, photo, loss))

    def check(
        self, step: int, parameters: Mapping[str, Tensor], skipped_rows: int | Tensor
    ) -> None:
        """Look at what came since the last check.

        Args:
            step: steps done.
            parameters: name -> (N, ...) tensor.
            skipped_rows: rows whose gradient was not finite, ever (`VisibleAdam.skipped_rows`).

        Raises:
            TrainingError: a loss, a gradient or a parameter is not a finite number.
        """
        self._read_losses()
        since = f"between step {max(step - CHECK_EVERY, 0)} and step {step}"
        if int(skipped_rows):
            raise TrainingError(f"Gradients became NaN or infinite {since}.", HINT)
        for name, tensor in parameters.items():
            # A sum is finite only where all it adds up is, and costs one pass over memory.
            if bool(tensor.detach().sum().isfinite()):
                continue
            rows = int((~tensor.detach().isfinite()).reshape(len(tensor), -1).any(dim=1).sum())
            if rows:
                text = f"`{name}` of {rows} Gaussians became NaN or infinite {since}."
                raise TrainingError(text, HINT)

    def _read_losses(self) -> None:
        if not self._new:
            return
        new, self._new = self._new, []
        losses = torch.stack([loss for _, _, loss in new]).tolist()
        for (step, photo, _), loss in zip(new, losses, strict=True):
            if not np.isfinite(loss):
                raise TrainingError(
                    f"The loss became {loss} at step {step}, on the photo '{self._photos[photo]}'.",
                    HINT,
                )
            self._recent.setdefault(photo, deque(maxlen=VISITS)).append(loss)

    def outliers(self) -> list[str]:
        """Photos whose loss stays far above that of the others, the worst first, in words."""
        self._read_losses()
        # The least of its last losses: a photo must be bad on every visit.
        least = {k: min(v) for k, v in self._recent.items() if len(v) == VISITS}
        if len(least) < FEWEST_PHOTOS:
            return []
        values = np.array(list(least.values()))
        middle = float(np.median(values))
        spread = 1.4826 * float(np.median(np.abs(values - middle)))
        limit = max(middle + DEVIATIONS * spread, TIMES * middle)
        worst = sorted((k for k in least if least[k] > limit), key=lambda k: -least[k])
        return [
            f"The photo '{self._photos[k]}' does not fit the others: its loss stays at"
            f" {least[k]:.3f}, theirs is {middle:.3f} (median). Is it sharp, of this scene, and"
            " posed well? A close-up that few others are like is no fault."
            for k in worst
        ]
