"""What the photos of a box say together: the near and far ones, the best and the worst gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

FEW_VIEWS = 3  # test photos; the scores of fewer say little, and have no near and far third


def near_and_far(distances: Mapping[str, float]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The third of the photos with the nearest cameras, and that with the farthest; nearest first.

    A third of N photos is N / 3, rounded: 1 of 3 or 4 photos, 2 of 5 to 7, 3 of 8. No photo is
    in both. Both are empty for fewer than `FEW_VIEWS` photos. Equal distances go by name.

    Args:
        distances: photo -> distance of its camera from the box.
    """
    if len(distances) < FEW_VIEWS:
        return (), ()
    order = sorted(distances, key=lambda name: (distances[name], name))
    third = (len(order) + 1) // 3
    return tuple(order[:third]), tuple(order[-third:])


@dataclass(frozen=True, kw_only=True)
class Gains:
    """What a model gains over another one on single photos, in ROI PSNR, dB.

    Attributes:
        peak_view, peak: the photo with the largest gain, and that gain.
        worst_view, worst: the photo with the least gain, and that gain.
        won: share of the photos with a gain above 0.
    """

    peak_view: str | None = None
    peak: float | None = None
    worst_view: str | None = None
    worst: float | None = None
    won: float | None = None

    @classmethod
    def of(cls, gains: Mapping[str, float]) -> Gains:
        """From the gain on each photo; all None without photos. The first of equals is named."""
        if not gains:
            return cls()
        peak = max(gains, key=lambda name: gains[name])
        worst = min(gains, key=lambda name: gains[name])
        return cls(
            peak_view=peak,
            peak=gains[peak],
            worst_view=worst,
            worst=gains[worst],
            won=sum(gain > 0 for gain in gains.values()) / len(gains),
        )


def mean(values: Sequence[float]) -> float | None:
    """The mean; None without values."""
    return float(np.mean(values)) if values else None
