"""Settings of a run as a frozen value; torch-free.

Comments mark the values that differ from the paper or from 3DGS; notebook/README.md has the
measurements.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace
from typing import Any

from ..errors import ConfigError
from ..requests import choices
from ..selection.config import SelectionConfig
from ..training.config import TrainConfig, check_limits, limited, miniature, with_steps
from ..training.mechanisms.floater_pruning import FloaterPruning

AUTO_BLOCKS = 0  # the number is derived from this machine's memory


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Everything that decides the result of a run, except its scene and boxes.

    Attributes:
        preset: name of the preset that the values come from.
        strategy: `joint` (one stage for all boxes, no composition) or `independent` (the paper's
            Object-GS for each box, then composition).
        selection: how the photos of each box are selected.
        kept_share: share of each box's selected photos that the Scene-GS also trains on (paper:
            0.5), spread evenly over the selection.
        scene, roi: settings of the two stages, the Scene-GS and the box stage.
        scene_scale: factor on the size of the photos that the Scene-GS trains on.
        roi_init: the start of the box stage: the whole Scene-GS, the sparse points, or the
            Scene-GS's Gaussians in the box (the last two are the paper's ablations).
        roi_order: `ordered` repeats the selection in its order (paper); `shuffled` draws epochs.
        selected_share: of the steps of the joint stage (and the joint refinement) that train on a
            mask, the share that draws a selected photo; the others draw any training photo that
            sees a box.
        refine_share: `independent` only: share of the box stage's steps that go to the joint
            refinement instead of the Object-GS. 0: no joint refinement (paper).
        baseline_densify: share of the baselines' steps that densify (3DGS: 15,000 of 30,000; paper:
            15,000 of 50,000).
        whole_schedule: whether `scaled` also scales the intervals of the schedule.
        test_every: every n-th photo that sees a box, by distance, becomes a test photo.
        evaluate_on: `test` photos or `validation` photos. Use the latter to choose settings; test
            photos are then not used at all.
        seed: of everything random.
        blocks: number of blocks that the scene is divided into; 1: it is not divided. `define_run`
            replaces `AUTO_BLOCKS`.
        groups: names of the boxes that are trained together; empty: derived from shared photos.
    """

    preset: str
    strategy: str
    selection: SelectionConfig
    kept_share: float = limited(least=0, most=1)
    scene: TrainConfig
    roi: TrainConfig
    scene_scale: float = limited(1.0, above=0, most=1)
    roi_init: str = "scene"
    roi_order: str = "ordered"
    selected_share: float = limited(0.5, least=0, most=1)
    refine_share: float = limited(0.0, least=0, most=1)
    baseline_densify: float = limited(0.5, least=0, most=1)
    whole_schedule: bool = False
    test_every: int = 8
    evaluate_on: str = choices.TEST
    seed: int = limited(0, least=0, most=choices.MAX_SEED)
    blocks: int = 1
    groups: tuple[tuple[str, ...], ...] = ()

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("strategy", self.strategy, choices.STRATEGIES),
            ("roi_init", self.roi_init, choices.INITS),
            ("roi_order", self.roi_order, choices.ORDERS),
            ("evaluate_on", self.evaluate_on, choices.PHOTOS),
        ):
            if value not in allowed:
                raise ConfigError(f"{name} is '{value}'.", f"Use one of {', '.join(allowed)}.")
        check_limits(self)
        if self.scene.made_for != self.roi.made_for:
            raise ConfigError(
                f"The Scene-GS is made for {self.scene.made_for}, the box stage for"
                f" {self.roi.made_for}.",
                "Set scene.made_for and roi.made_for alike.",
            )
        if self.scene.get(FloaterPruning):
            raise ConfigError(
                f"The Scene-GS uses {FloaterPruning.name}, but has no boxes.",
                "Use it in the box stage.",
            )
        if self.evaluate_on == choices.VALIDATION and not self.test_every:
            raise ConfigError(
                "Without test photos (test_every 0) there are no validation photos.",
                "Set test_every to 2 or more.",
            )
        if not 0 <= self.blocks <= choices.MOST_BLOCKS:
            raise ConfigError(
                f"blocks is {self.blocks}.",
                f"Use a number from 1 to {choices.MOST_BLOCKS}, or auto.",
            )
        if self.strategy != "joint" and self.groups:
            raise ConfigError(
                f"The strategy `{self.strategy}` trains each box alone, so --group has no use.",
                "Leave it out, or use the strategy `joint`.",
            )
        if self.strategy == "joint" and self.roi_init == "box":
            raise ConfigError(
                "roi_init 'box' drops the background, which the strategy `joint` needs.",
                "Use the strategy `independent` with it.",
            )

    @property
    def total_steps(self) -> int:
        """Steps of both stages; a baseline gets as many."""
        return self.scene.steps + self.roi.steps

    def to_dict(self) -> dict[str, Any]:
        """The config as JSON values, without `groups`."""
        record = {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}
        record["selection"] = dataclasses.asdict(self.selection)
        record |= {"scene": self.scene.to_dict(), "roi": self.roi.to_dict()}
        del record["groups"]  # the manifest always has them, also if derived from the photos
        return record

    def scaled(self, factor: float) -> RunConfig:
        """The config with the steps of both stages multiplied by `factor`.

        Uses `miniature` with `whole_schedule`, otherwise `with_steps`.
        """
        if not 0 < factor <= choices.MAX_FACTOR:
            raise ConfigError(
                f"The step factor is {factor:g}.",
                f"Use a number above 0, at most {choices.MAX_FACTOR}.",
            )
        scene, roi = (max(1, round(c.steps * factor)) for c in (self.scene, self.roi))
        resized = miniature if self.whole_schedule else with_steps
        return replace(self, scene=resized(self.scene, scene), roi=resized(self.roi, roi))

    @property
    def refine_steps(self) -> int:
        """Steps of the joint refinement; 0: there is none."""
        return round(self.refine_share * self.roi.steps) if self.strategy == "independent" else 0
