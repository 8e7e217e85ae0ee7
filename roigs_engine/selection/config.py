"""Settings of the photo selection."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import ConfigError
from ..requests.choices import MAX_SEED
from .methods import METHODS

# The paper selects 150 of 314 candidates (sec. III-A); small scenes use the same share.
PAPER_COUNT, PAPER_SHARE = 150, 0.48


@dataclass(frozen=True, kw_only=True)
class SelectionConfig:
    """Settings of the photo selection.

    Attributes:
        method: one of `METHODS`.
        count: number of photos to select; None: min(limit, ceil(share x candidates)).
        share: see `count`; paper: 0.48.
        limit: most photos that `share` may select; 0: no limit.
        seed: of `random`, and of the Gaussian process's optimizer restarts.
    """

    method: str = "coverage"
    count: int | None = None
    share: float = PAPER_SHARE
    limit: int = PAPER_COUNT
    seed: int = 0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ConfigError(
                f"Unknown selection method '{self.method}'.", f"Use one of {', '.join(METHODS)}."
            )
        if self.count is not None and self.count < 1:
            raise ConfigError(f"Cannot select {self.count} photos.", "Set count to 1 or more.")
        if not 0 < self.share <= 1:
            raise ConfigError(f"The share to select is {self.share:g}.", "Use above 0, up to 1.")
        if self.limit < 0:
            raise ConfigError(f"The limit of the selection is {self.limit}.", "Use 0 or more.")
        if not 0 <= self.seed <= MAX_SEED:
            raise ConfigError(
                f"The selection's seed is {self.seed}.", f"Use an integer from 0 to {MAX_SEED:,}."
            )

    def resolved_count(self, candidates: int) -> int:
        """The number of photos to select from this number of candidates, at most all."""
        if self.count is not None:
            return min(self.count, candidates)
        # Without 1e-9, rounding errors such as 0.48 x 25 = 12.000000000000002 would give 13.
        wanted = min(math.ceil(self.share * candidates - 1e-9), candidates)
        return min(self.limit, wanted) if self.limit else wanted
