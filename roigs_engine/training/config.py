"""Settings of one training stage, as a frozen value; torch-free.

A value that differs from the paper or from 3DGS says so beside it; docs/results.md names the
measurement behind it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ..errors import ConfigError


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
        box_budget: factor of the most Gaussians a box may hold, see `capacity.py`; 0: no limit.
        box_grad_threshold: takes the place of `grad_threshold` in the boxes; 0: the same there.
        full_every: in a ROI stage one step of so many looks at a whole photo, drawn from all; the
            others look at the boxes' silhouettes and a rim, in photos that see a box (`region.py`).
            1: all look at whole photos (paper).
        view_weighting: in those steps, 0: a pixel pulls as hard as in a whole photo; 1: a photo as
            hard as another, on however many pixels it shows the boxes; above, up to 2: one that
            shows them small pulls harder (`Regions`).
        prune_opacity: Gaussians below it are removed at densification steps.
        prune_size: larger ones (share of the scene extent) are removed after the first reset.
        reset_every: opacities drop to 0.01 every so many steps while densifying; 0: never.
        contribution_every: Gaussians whose alpha x T stayed below 1/255 on every training pixel of
            a window of at least so many steps are removed; 0: never.
        min_views: the stage ends without Gaussians that stand before the boxes and fewer
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
    box_budget: float = 0.0
    box_grad_threshold: float = 0.0
    full_every: int = 1
    view_weighting: float = 0.0
    prune_opacity: float = 0.005
    prune_size: float = 0.1
    reset_every: int = 3000
    contribution_every: int = 0
    min_views: int = 0
    average_steps: int = 0

    def __post_init__(self) -> None:
        if self.full_every < 1:
            raise ConfigError(f"full_every is {self.full_every}.", "Use 1 or more.")
        if self.full_every > 1 and self.contribution_every:
            raise ConfigError(
                "contribution_every needs steps that look at whole photos.",
                "Set full_every to 1, or contribution_every to 0.",
            )
        if not 0 <= self.view_weighting <= 2:
            raise ConfigError(
                f"view_weighting is {self.view_weighting:g}.", "Use a number from 0 to 2."
            )

    def position_learning_rate(self, step: int) -> float:
        """Learning rate of positions at a step, before the scene extent."""
        t = min(step / max(self.steps, 1), 1.0)
        return math.exp((1 - t) * math.log(self.lr_means) + t * math.log(self.lr_means_final))

    def degree(self, step: int) -> int:
        """Spherical-harmonics degree in use at a step."""
        return min(self.sh_degree, self.sh_start + step // max(self.sh_every, 1))


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
