"""The selection's values: its settings, the candidates it works on, and its result."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ..errors import ConfigError, RunFolderError
from ..roi import OrientedBox
from ..scene import Float64, Int64, PosedImage

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
        acquisition: the gp's, «ucb» or «ei».
        beta: weight of the standard deviation in «ucb», >= 0.
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
                f"Unknown selection method «{self.method}».", f"Use one of {', '.join(METHODS)}."
            )
        if self.acquisition not in ACQUISITIONS:
            raise ConfigError(
                f"Unknown acquisition «{self.acquisition}».", f"Use {' or '.join(ACQUISITIONS)}."
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """The photos that see the box, and which of the box's points each of them sees.

    The visibility matrix A (method: A[v, p] = 1 where photo v observes point p) is stored as its
    non-zero entries, ordered by photo.

    Attributes:
        roi: the box.
        images: V photos in name order; a photo's index in here is its id in every method.
        points: (P, 3) the scene's points inside the box, world units.
        obs_view: (N,) photo of each observation, ascending.
        obs_point: (N,) row of `points` of each observation, ascending within a photo.
        flags: degenerate cases met while finding them.
    """

    roi: OrientedBox
    images: tuple[PosedImage, ...]
    points: Float64
    obs_view: Int64
    obs_point: Int64
    flags: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.images)

    @property
    def names(self) -> tuple[str, ...]:
        """(V,) photo names, ascending."""
        return tuple(image.name for image in self.images)

    def centres(self) -> Float64:
        """(V, 3) camera centres in the world."""
        return np.array([image.centre for image in self.images]).reshape(-1, 3)

    def forwards(self) -> Float64:
        """(V, 3) unit viewing directions in the world."""
        return np.array([image.forward for image in self.images]).reshape(-1, 3)

    def row_starts(self) -> Int64:
        """(V + 1,) photo v owns the observations row_starts[v] to row_starts[v + 1]."""
        return np.searchsorted(self.obs_view, np.arange(len(self) + 1)).astype(np.int64)


@dataclass(frozen=True, kw_only=True)
class Picks:
    """What a method returns: candidate ids, best first.

    Attributes:
        order: ids, unique.
        filled_from: position in `order` from which on no photo improved the method's score and
            farthest views were taken; None when that did not happen.
        flags: degenerate cases met.
    """

    order: tuple[int, ...]
    filled_from: int | None = None
    flags: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class CameraSelection:
    """The chosen photos of one box.

    Attributes:
        roi: the box's name.
        method: one of `METHODS`.
        names: chosen photos, best first.
        scores: the score after each pick: for `coverage` the share of what all candidates together
            would give, else density x occupancy of the points in the box (both 0 to 1).
        candidates: every photo that sees the box, in name order.
        flags: sentences about degenerate cases met.
        features: candidate -> «distance» (world units, to the box's centre), «area» (share of the
            image that the box covers), «keypoints» (points in the box that the photo sees).
    """

    roi: str
    method: str
    names: tuple[str, ...]
    scores: tuple[float, ...]
    candidates: tuple[str, ...]
    flags: tuple[str, ...] = ()
    features: dict[str, dict[str, float]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """The JSON form that `from_dict` reads."""
        record = asdict(self)
        return {key: list(v) if isinstance(v, tuple) else v for key, v in record.items()}

    @classmethod
    def from_dict(cls, record: Any) -> CameraSelection:
        """The selection stored by `to_dict`.

        Raises:
            RunFolderError: a key is missing or has the wrong type.
        """
        try:
            selection = cls(
                roi=str(record["roi"]),
                method=str(record["method"]),
                names=tuple(str(name) for name in record["names"]),
                scores=tuple(float(score) for score in record["scores"]),
                candidates=tuple(str(name) for name in record["candidates"]),
                flags=tuple(str(flag) for flag in record["flags"]),
                features={
                    str(name): {str(key): float(value) for key, value in values.items()}
                    for name, values in record["features"].items()
                },
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise RunFolderError(
                f"A stored camera selection is malformed ({type(error).__name__}: {error}).",
                "Run the selection again.",
            ) from error
        if len(selection.names) != len(selection.scores):
            raise RunFolderError(
                f"A stored camera selection has {len(selection.names)} photos but"
                f" {len(selection.scores)} scores.",
                "Run the selection again.",
            )
        return selection
