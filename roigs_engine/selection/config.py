"""How photos are chosen: methods and settings."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import ConfigError

METHODS = ("static", "gp6", "gp9", "greedy", "coverage", "fvs", "random")


ACQUISITIONS = ("ucb", "ei")


# The paper selects 150 of 314 candidates (sec. III-A); small scenes keep that share.
PAPER_COUNT = 150


PAPER_SHARE = 0.48


@dataclass(frozen=True, kw_only=True)
class SelectionConfig:
    """How photos are chosen.

    Attributes:
        method: one of `METHODS`.
        count: photos to choose; None for min(150, ceil(share x candidates)).
        share: see `count`; the paper's is 0.48.
        seed: of `random`, of the gp's optimiser restarts and of `gp_refresh`'s samples.
        acquisition: the gp's, 'ucb' or 'ei'.
        beta: weight of the standard deviation in 'ucb', >= 0.
        gp_refresh: measure the present gain of up to 32 unselected photos at every step and fit
            the gp on those, instead of on the gains (gone stale) of the photos already chosen.
        gp_refit_every: picks between two optimisations of the gp's hyper-parameters.
        direction_bins: directions in which `coverage` wants to see each point, 6 to 512.
    """

    method: str = "coverage"
    count: int | None = None
    share: float = PAPER_SHARE
    seed: int = 0
    acquisition: str = "ucb"
    beta: float = 2.0
    gp_refresh: bool = False
    gp_refit_every: int = 10
    direction_bins: int = 32

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ConfigError(
                f"Unknown selection method '{self.method}'.", f"Use one of {', '.join(METHODS)}."
            )
        if self.acquisition not in ACQUISITIONS:
            raise ConfigError(
                f"Unknown acquisition '{self.acquisition}'.", f"Use {' or '.join(ACQUISITIONS)}."
            )
        if self.count is not None and self.count < 1:
            raise ConfigError(f"Cannot select {self.count} photos.", "Set count to 1 or more.")
        if not 0 < self.share <= 1:
            raise ConfigError(f"The share to select is {self.share:g}.", "Use above 0, up to 1.")
        if not (math.isfinite(self.beta) and self.beta >= 0):
            raise ConfigError(f"beta is {self.beta}.", "Set it to a number from 0 on (default 2).")
        if not 0 <= self.seed < 1 << 32:
            raise ConfigError(
                f"The selection's seed is {self.seed}.", "Use a number from 0 to 4294967295."
            )
        if self.gp_refit_every < 1:
            raise ConfigError(f"gp_refit_every is {self.gp_refit_every}.", "Set it to 1 or more.")
        if not 6 <= self.direction_bins <= 512:
            raise ConfigError(f"direction_bins is {self.direction_bins}.", "Use 6 to 512.")

    def resolved_count(self, candidates: int) -> int:
        """How many of that many candidates are chosen (never more than there are)."""
        if self.count is not None:
            return min(self.count, candidates)
        # The small subtraction keeps e.g. 0.48 x 25 = 12.000000000000002 from becoming 13.
        return min(PAPER_COUNT, math.ceil(self.share * candidates - 1e-9), candidates)
