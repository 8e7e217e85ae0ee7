"""Settings of a run as a frozen value; torch-free.

A value that differs from the paper or from 3DGS says so beside it; docs/results.md names the
measurement behind it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace
from typing import Any

from ..errors import ConfigError
from ..selection.config import SelectionConfig
from ..training.config import TrainConfig, with_steps

STRATEGIES = ("joint", "independent")
INITS = ("scene", "points", "box")
ORDERS = ("ordered", "shuffled")
MAX_FACTOR = 1000  # of the steps: a larger one is a slip of the finger
COMPARISONS = ("full-scene", "full-object", *STRATEGIES)


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Everything that decides the result of a run, beside its scene and its boxes.

    Attributes:
        preset: where the values came from.
        strategy: `joint` (one stage for all boxes, nothing is cut) or `independent` (the paper's
            Object-GS per box, then composition).
        selection: how the ROI stage's photos are chosen.
        kept_share: share of each ROI's selected photos that Scene-GS sees too (paper: 0.5); the
            k-th photo stays when floor(k share) grows.
        scene, roi: the two stages.
        scene_scale: the Scene-GS learns from photos at this share of their size.
        roi_init: what the ROI stage starts from: the whole Scene-GS, the sparse points, or the
            Scene-GS's Gaussians in the box (the paper's ablations).
        roi_order: `ordered` follows the selection and cycles (paper); `shuffled` draws epochs.
        selected_share: in the joint stage (and the seam stage) share of the steps that look at
            boxes which draw a selected photo; the others draw any training photo that sees a box.
        refine_share: independent only; share of the ROI stage's steps that the composed model gets
            instead of the objects. 0: composition is the end (paper).
        test_every: every n-th ROI-visible photo, by distance, is kept for the tests.
        seed: of everything random.
    """

    preset: str
    strategy: str
    selection: SelectionConfig
    kept_share: float
    scene: TrainConfig
    roi: TrainConfig
    scene_scale: float = 1.0
    roi_init: str = "scene"
    roi_order: str = "ordered"
    selected_share: float = 0.5
    refine_share: float = 0.0
    test_every: int = 8
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("strategy", self.strategy, STRATEGIES),
            ("roi_init", self.roi_init, INITS),
            ("roi_order", self.roi_order, ORDERS),
        ):
            if value not in allowed:
                raise ConfigError(f"{name} is '{value}'.", f"Use one of {', '.join(allowed)}.")
        for name, share in (
            ("kept_share", self.kept_share),
            ("selected_share", self.selected_share),
            ("refine_share", self.refine_share),
        ):
            if not 0 <= share <= 1:
                raise ConfigError(f"{name} is {share:g}.", "Use a number from 0 to 1.")
        if self.scene.min_views:
            raise ConfigError(
                f"scene.min_views is {self.scene.min_views}; the Scene-GS knows no boxes.",
                "Set roi.min_views instead.",
            )
        if not 0 < self.scene_scale <= 1:
            raise ConfigError(
                f"scene_scale is {self.scene_scale:g}.", "Use a number above 0, 1 at most."
            )
        if not 0 <= self.seed < 1 << 32:
            raise ConfigError(f"The seed is {self.seed}.", "Use a number from 0 to 4294967295.")
        if self.strategy == "joint" and self.roi_init == "box":
            raise ConfigError(
                "roi_init 'box' throws the surroundings away, which `joint` needs.",
                "Use the strategy `independent` with it.",
            )

    @property
    def total_steps(self) -> int:
        """Steps of both stages: what a baseline is given."""
        return self.scene.steps + self.roi.steps

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return dataclasses.asdict(self)

    def scaled(self, factor: float) -> RunConfig:
        """Both stages with their steps multiplied, see `with_steps`."""
        if not 0 < factor <= MAX_FACTOR:
            raise ConfigError(
                f"The step factor is {factor:g}.", f"Use a number above 0, {MAX_FACTOR} at most."
            )
        scene, roi = (max(1, round(c.steps * factor)) for c in (self.scene, self.roi))
        return replace(self, scene=with_steps(self.scene, scene), roi=with_steps(self.roi, roi))

    @property
    def refine_steps(self) -> int:
        """Steps of the seam stage; 0: there is none."""
        return round(self.refine_share * self.roi.steps) if self.strategy == "independent" else 0
