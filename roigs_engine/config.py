"""Settings of a run as frozen values, and the presets that people start from; torch-free.

A value that differs from the paper or from 3DGS says so beside it; docs/results.md names the
measurement behind it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from .errors import ConfigError
from .selection import SelectionConfig

STRATEGIES = ("joint", "independent")
INITS = ("scene", "points", "box")
ORDERS = ("ordered", "shuffled")
SEAM_SHARE = 0.2  # of the ROI stage, where a composition is refined (docs/results.md)
MAX_FACTOR = 1000  # of the steps: a larger one is a slip of the finger
COMPARISONS = ("full-scene", "full-object", *STRATEGIES)


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training stage: standard 3DGS (Kerbl et al. 2023), steps counted from 0.

    Attributes:
        steps: optimisation steps, one photo each.
        sh_degree, sh_start, sh_every: highest degree, degree at the start, steps between raises.
        ssim_weight: weight of 1 - SSIM beside L1.
        lr_means, lr_means_final: position rates x scene extent, exponential in between.
        lr_sh0, lr_shN, lr_opacities, lr_scales, lr_quats: Adam rates.
        lr_shN_spacing: where photos stand farther apart around a box than so many degrees, `lr_shN`
            is lowered (`spacing.py`); 0: it is not.
        densify_from, densify_until, densify_every: steps.
        grad_threshold: mean 2D gradient above which a Gaussian is cloned or split.
        split_fraction: a Gaussian larger than this share of the size reference is split.
        densify_in_boxes: only Gaussians whose centre is in a box are cloned or split (paper,
            sec. II-B), with min(scene extent, box diagonal) as the size reference.
        box_margin: for densification and its limits, boxes are so many times larger: what stands
            close around an object fills much of its silhouette.
        box_capacity: factor of the most Gaussians a box may hold, see `capacity.py`; 0: no limit.
        box_grad_threshold: takes the place of `grad_threshold` in the boxes; 0: the same there.
        full_every: in a ROI stage one step of so many looks at a whole photo, drawn from all; the
            others look at the boxes' silhouettes and a rim, in photos that see a box (`region.py`).
            1: all look at whole photos (paper).
        photo_balance: in those steps, 0: a pixel pulls as hard as in a whole photo; 1: a photo as
            hard as another, on however many pixels it shows the boxes; above, up to 2: one that
            shows them small pulls harder (`Regions`).
        prune_opacity: Gaussians below it are removed at densification steps.
        prune_size: larger ones (share of the scene extent) are removed after the first reset.
        reset_every: opacities drop to 0.01 every so many steps while densifying; 0: never.
        contribution_every: Gaussians whose alpha x T stayed below 1/255 on every training pixel of
            a window of at least so many steps are removed; 0: never.
        front_photos: the stage ends without Gaussians that stand before the boxes and fewer
            training photos than this show, and without those in the boxes that none shows
            (`floaters.py`); 0: all stay.
        average_steps: the stage ends with the mean of the models that it went through in its last
            so many steps; 0: with the last one, as 3DGS.
    """

    steps: int
    sh_degree: int = 3
    sh_start: int = 0
    sh_every: int = 1000
    ssim_weight: float = 0.2
    lr_means: float = 1.6e-4
    lr_means_final: float = 1.6e-6
    lr_sh0: float = 2.5e-3
    lr_shN: float = 1.25e-4  # noqa: N815 - the field's name
    lr_shN_spacing: float = 0.0  # noqa: N815
    lr_opacities: float = 0.05
    lr_scales: float = 5e-3
    lr_quats: float = 1e-3
    densify_from: int = 500
    densify_until: int = 15_000
    densify_every: int = 100
    grad_threshold: float = 2e-4
    split_fraction: float = 0.01
    densify_in_boxes: bool = False
    box_margin: float = 1.0
    box_capacity: float = 0.0
    box_grad_threshold: float = 0.0
    full_every: int = 1
    photo_balance: float = 0.0
    prune_opacity: float = 0.005
    prune_size: float = 0.1
    reset_every: int = 3000
    contribution_every: int = 0
    front_photos: int = 0
    average_steps: int = 0

    def __post_init__(self) -> None:
        if self.full_every < 1:
            raise ConfigError(f"full_every is {self.full_every}.", "Use 1 or more.")
        if self.full_every > 1 and self.contribution_every:
            raise ConfigError(
                "contribution_every needs steps that look at whole photos.",
                "Set full_every to 1, or contribution_every to 0.",
            )
        if not 0 <= self.photo_balance <= 2:
            raise ConfigError(
                f"photo_balance is {self.photo_balance:g}.", "Use a number from 0 to 2."
            )

    def position_rate(self, step: int) -> float:
        """Learning rate of positions at a step, before the scene extent."""
        t = min(step / max(self.steps, 1), 1.0)
        return math.exp((1 - t) * math.log(self.lr_means) + t * math.log(self.lr_means_final))

    def degree(self, step: int) -> int:
        """Spherical-harmonics degree in use at a step."""
        return min(self.sh_degree, self.sh_start + step // max(self.sh_every, 1))


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
        seam_share: independent only; share of the ROI stage's steps that the composed model gets
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
    seam_share: float = 0.0
    test_every: int = 8
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("strategy", self.strategy, STRATEGIES),
            ("roi_init", self.roi_init, INITS),
            ("roi_order", self.roi_order, ORDERS),
        ):
            if value not in allowed:
                raise ConfigError(f"{name} is «{value}».", f"Use one of {', '.join(allowed)}.")
        for name, share in (
            ("kept_share", self.kept_share),
            ("selected_share", self.selected_share),
            ("seam_share", self.seam_share),
        ):
            if not 0 <= share <= 1:
                raise ConfigError(f"{name} is {share:g}.", "Use a number from 0 to 1.")
        if self.scene.front_photos:
            raise ConfigError(
                f"scene.front_photos is {self.scene.front_photos}; the Scene-GS knows no boxes.",
                "Set roi.front_photos instead.",
            )
        if not 0 < self.scene_scale <= 1:
            raise ConfigError(
                f"scene_scale is {self.scene_scale:g}.", "Use a number above 0, 1 at most."
            )
        if not 0 <= self.seed < 1 << 32:
            raise ConfigError(f"The seed is {self.seed}.", "Use a number from 0 to 4294967295.")
        if self.strategy == "joint" and self.roi_init == "box":
            raise ConfigError(
                "roi_init «box» throws the surroundings away, which `joint` needs.",
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

    def baseline(self) -> TrainConfig:
        """The stage of the Full Scene and Full Object baselines: 3DGS over the steps of both.

        It densifies for the first half, as 3DGS does (15K of 30K).
        """
        return replace(
            self.scene,
            steps=self.total_steps,
            densify_until=self.total_steps // 2,
            lr_means_final=TrainConfig.lr_means_final,
            grad_threshold=TrainConfig.grad_threshold,
            reset_every=TrainConfig.reset_every,
        )

    def matched_baseline(self) -> TrainConfig:
        """The baseline, densified in the boxes more readily than the ROI stage is.

        What limits it shall be the number of Gaussians allowed there: the threshold is a quarter.
        """
        return replace(self.baseline(), box_grad_threshold=self.roi.grad_threshold / 4)

    @property
    def seam_steps(self) -> int:
        """Steps of the seam stage; 0: there is none."""
        return round(self.seam_share * self.roi.steps) if self.strategy == "independent" else 0

    def object_stage(self) -> TrainConfig:
        """The stage of an Object-GS: what the seam stage leaves of the ROI stage's steps."""
        return with_steps(self.roi, self.roi.steps - self.seam_steps)

    def seam_stage(self) -> TrainConfig:
        """The stage that the composed model ends with: the joint one's, without new Gaussians."""
        return replace(
            _short("", self.scene.steps, self.roi.steps).roi,
            steps=self.seam_steps,
            sh_degree=self.roi.sh_degree,
            sh_start=self.roi.sh_degree,
            densify_until=0,
            box_capacity=0.0,
            average_steps=self.seam_steps // 2,
        )

    def in_strategy(self, strategy: str) -> RunConfig:
        """The same steps, degree, tests, seed and number of photos in another strategy.

        That is the paper's own, or the preset's recipe for all boxes together.
        """
        label = f"{self.preset}, {strategy}"
        if strategy == "joint":
            named = PRESETS.get(self.preset.partition(",")[0])
            threshold = named().scene.grad_threshold if named else TrainConfig.grad_threshold
            other = _short(label, self.scene.steps, self.roi.steps, threshold)
        else:
            other = _paper()
            other = replace(
                other,
                preset=label,
                seam_share=SEAM_SHARE,
                scene=with_steps(other.scene, self.scene.steps),
                roi=with_steps(other.roi, self.roi.steps),
            )
        chosen = replace(other.selection, seed=self.seed, count=self.selection.count)
        return replace(
            other,
            scene=replace(other.scene, sh_degree=self.scene.sh_degree),
            roi=replace(other.roi, sh_degree=self.roi.sh_degree),
            selection=chosen,
            test_every=self.test_every,
            seed=self.seed,
        )


def with_steps(config: TrainConfig, steps: int) -> TrainConfig:
    """The stage `steps` long, its shares of densifying and of averaged steps as before.

    The steps from which densification starts and between degrees and resets stay: they count
    what Adam and the statistics need, not shares of a schedule.
    """
    until, averaged = (
        round(share * steps / config.steps)
        for share in (config.densify_until, config.average_steps)
    )
    return replace(config, steps=steps, densify_until=until, average_steps=averaged)


def _paper() -> RunConfig:
    """Section II-B and III-A of the paper, gaps filled as docs/method.md says."""
    return RunConfig(
        preset="paper",
        strategy="independent",
        selection=SelectionConfig(method="gp9"),
        kept_share=0.5,
        scene=TrainConfig(steps=20_000, densify_until=10_000),
        roi=TrainConfig(
            steps=30_000,
            sh_start=3,
            densify_from=0,
            densify_until=15_000,
            densify_in_boxes=True,
            reset_every=0,
            contribution_every=1000,
        ),
    )


def _short(
    name: str,
    scene_steps: int,
    roi_steps: int,
    scene_threshold: float = TrainConfig.grad_threshold,
) -> RunConfig:
    """The joint recipe: a short Scene-GS, then one stage that densifies in the boxes only.

    What differs from 3DGS and the paper is measured in docs/results.md.
    """
    # The scene's position rates decay as the baseline's do over its first steps: it is not done
    # at its end. The ROI stage begins at the full rate again, for its new Gaussians must travel.
    middle = 1.6e-4 * (1.6e-6 / 1.6e-4) ** (scene_steps / (scene_steps + roi_steps))
    return RunConfig(
        preset=name,
        strategy="joint",
        selection=SelectionConfig(method="coverage"),
        kept_share=1.0,
        scene_scale=0.5,
        scene=TrainConfig(
            steps=scene_steps,
            densify_until=scene_steps * 5 // 8,
            grad_threshold=scene_threshold,
            lr_means_final=middle,
            reset_every=0,  # so short a stage does not recover: a haze would stay
        ),
        roi=TrainConfig(
            steps=roi_steps,
            sh_start=3,
            # 3DGS's rates suit six times as many steps; view dependence is last to come.
            lr_shN=1.5e-3,
            lr_shN_spacing=25.0,
            lr_scales=0.01,
            densify_from=0,
            densify_until=roi_steps // 3,
            densify_in_boxes=True,
            grad_threshold=8e-5,
            box_capacity=2.2,
            full_every=4,
            photo_balance=1.0,
            reset_every=0,
            front_photos=4,
            average_steps=roi_steps // 10,
        ),
        roi_order="shuffled",
        selected_share=0.2,
    )


PRESETS: dict[str, Callable[[], RunConfig]] = {
    "paper": _paper,
    # Densified for so long, the Scene-GS would come to more Gaussians than the boxes need around.
    "standard": lambda: _short("standard", 6000, 9000, scene_threshold=3e-4),
    "draft": lambda: _short("draft", 2000, 3000),
}


def preset(name: str) -> RunConfig:
    """The preset of that name.

    Raises:
        ConfigError: there is none.
    """
    if name not in PRESETS:
        raise ConfigError(f"There is no preset «{name}».", f"Use one of {', '.join(PRESETS)}.")
    return PRESETS[name]()
