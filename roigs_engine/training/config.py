"""Settings of one training stage, as a frozen value; torch-free.

Comments mark the values that differ from the paper or from 3DGS; notebook/README.md has the
measurements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from ..errors import ConfigError
from .photo_order import is_whole

# What `miniature` scales beside the steps.
INTERVALS = ("sh_every", "densify_from", "densify_every", "reset_every", "contribution_every")

AVERAGE_EVERY = 10  # steps between the models that are averaged: consecutive ones hardly differ

DECAY_EVERY = 10  # steps between two decays of opacities at the least, or Adam could not keep up

# Fields that records of settings leave out where they are off: these stages train as before them.
ADDED = (
    "antialiased",
    "backdrop_cells",
    "faint_growth",
    "near_grad_threshold",
    "opacity_decay",
    "outside_spared",
    "outside_spared_spread",
    "outside_rate",
    "restarts",
)


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training stage: standard 3DGS (Kerbl et al. 2023); steps count from 0.

    Attributes:
        steps: optimisation steps, one photo each.
        sh_degree, sh_start, sh_every: highest SH degree, degree at the start, steps between raises.
        ssim_weight: weight w of 1 - SSIM in the loss; L1 has 1 - w.
        lr_means, lr_means_final: first and last position learning rate, in units of the scene
            extent; exponential decay.
        lr_sh0, lr_shN, lr_opacities, lr_scales, lr_quats: Adam's learning rates.
        lr_shN_spacing: above this angular view spacing around a box, degrees, `lr_shN` is lowered
            (`view_spacing.py`); 0: never.
        lr_shN_measured: lower `lr_shN` if the photos show that colours hardly depend on the view
            (`view_dependence.py`).
        densify_from, densify_until, densify_every: steps.
        grad_threshold: mean 2D gradient above which a Gaussian is cloned or split.
        split_fraction: a Gaussian larger than this share of the size reference is split.
        densify_in_boxes: clone and split only Gaussians whose centre is in a box (paper,
            sec. II-B), with min(scene extent, box diagonal) as the size reference.
        outside_grad_threshold: with `densify_in_boxes`, Gaussians outside the boxes above this
            gradient are densified too; 0: none (paper).
        near_grad_threshold: that threshold at the boxes' sides; it rises evenly to
            `outside_grad_threshold` over two diagonals of a box. 0, or not below that: it is the
            same everywhere.
        box_margin: factor on the sides of the boxes for densification, budgets and masks, because
            things close to an object fill much of its silhouette.
        box_budget: factor of the Gaussian budget of a box (`budget.py`); 0: no limit.
        box_grad_threshold: replaces `grad_threshold` in the boxes; 0: it does not.
        full_every: one step in `full_every` uses a whole photo, drawn from all photos; the others
            use the masks of photos that see a box (`masks.py`). 1: all steps use whole photos
            (paper).
        outside_rate: in steps on whole photos, the learning rates of Gaussians outside the boxes
            are multiplied by this, if other steps use masks (`outside.py`); 0: they are not.
        view_weighting: loss weights of masks (`RoiMasks`). 0: a pixel weighs as much as in a
            whole photo. 1: all photos weigh the same, however large the boxes are in them. Up to
            2: photos that show the boxes small weigh more.
        prune_opacity: Gaussians below this opacity are removed at densification steps.
        prune_size: Gaussians above this share of the scene extent are removed at densification
            steps, after the first opacity reset.
        reset_every: steps between opacity resets to 0.01 during densification; 0: none.
        faint_growth: when densification ends, the faintest Gaussians are removed, as long as the
            photos' squared error grows by no more than this share (`faint.py`); 0: none are.
        contribution_every: shortest window, in steps. At the end of a window, Gaussians are removed
            if their alpha x T stayed below 1/255 on all its training pixels; 0: never.
        min_views: at its end, the stage removes floaters (`floaters/`); of these, Gaussians
            before the boxes or the scene that fewer training photos show; 0: none.
        small_until: steps before this one use photos of half the size: coarse to fine, ours. They
            take half the time, and what they lack is learned after them.
        whole_small_until: steps before this one that use a whole photo have it at half the size
            too: what is beside the boxes needs no more.
        backdrop_cells: a stage that starts from the sparse points gets Gaussians where photos show
            none, too (`backdrop.py`): cells along a photo's longer side; 0: it gets none.
        opacity_decay: the share of its opacity that each Gaussian loses whenever the photos have
            gone round (`is_decayed`, `opacity_decay.py`); 0: none.
        outside_spared: Gaussians outside the boxes are spared this part of that share, if most
            steps use masks (`outside.py`); 0: none.
        outside_spared_spread: below this angular spread of the photos around the boxes, degrees,
            `outside_spared` is raised (`view_spread.py`); 0: never.
        restarts: so many times, at even distances and first when densification ends, Adam forgets
            its moments, except those of colours: warm restarts, ours. A Gaussian's steps are then
            several times as large, and shrink while photos show it some hundred times.
        average_steps: the result is the mean of the models of the last `average_steps` steps; 0:
            the last model, as in 3DGS.
        antialiased: draw Gaussians below a pixel's size fainter instead of larger, so that near and
            far photos agree (`rasterize`; Mip-Splatting, Yu et al. 2024, sec. 5.2); False: 3DGS.
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
    lr_shN_measured: bool = False  # noqa: N815
    lr_opacities: float = 0.05
    lr_scales: float = 5e-3
    lr_quats: float = 1e-3
    densify_from: int = 500
    densify_until: int = 15_000
    densify_every: int = 100
    grad_threshold: float = 2e-4
    split_fraction: float = 0.01
    densify_in_boxes: bool = False
    outside_grad_threshold: float = 0.0
    near_grad_threshold: float = 0.0
    box_margin: float = 1.0
    box_budget: float = 0.0
    box_grad_threshold: float = 0.0
    full_every: int = 1
    outside_rate: float = 0.0
    view_weighting: float = 0.0
    prune_opacity: float = 0.005
    prune_size: float = 0.1
    reset_every: int = 3000
    faint_growth: float = 0.0
    contribution_every: int = 0
    min_views: int = 0
    small_until: int = 0
    whole_small_until: int = 0
    backdrop_cells: int = 0
    opacity_decay: float = 0.0
    outside_spared: float = 0.0
    outside_spared_spread: float = 0.0
    restarts: int = 0
    average_steps: int = 0
    antialiased: bool = False

    def __post_init__(self) -> None:
        if self.full_every < 1:
            raise ConfigError(f"full_every is {self.full_every}.", "Use 1 or more.")
        if self.full_every > 1 and self.contribution_every:
            raise ConfigError(
                "contribution_every needs steps that use whole photos.",
                "Set full_every to 1, or contribution_every to 0.",
            )
        if not 0 <= self.outside_rate < math.inf:
            raise ConfigError(f"outside_rate is {self.outside_rate:g}.", "Use 0 or more.")
        if self.backdrop_cells < 0:
            raise ConfigError(f"backdrop_cells is {self.backdrop_cells}.", "Use 0 or more.")
        if not 0 <= self.opacity_decay < 1:
            raise ConfigError(
                f"opacity_decay is {self.opacity_decay:g}.", "Use 0 or more, and less than 1."
            )
        if not 0 <= self.outside_spared <= 1:
            raise ConfigError(f"outside_spared is {self.outside_spared:g}.", "Use 0 to 1.")
        if not 0 <= self.outside_spared_spread <= 90:
            raise ConfigError(
                f"outside_spared_spread is {self.outside_spared_spread:g}.",
                "Use 0 to 90 degrees.",
            )
        if self.restarts < 0:
            raise ConfigError(f"restarts is {self.restarts}.", "Use 0 or more.")
        if self.faint_growth < 0:
            raise ConfigError(f"faint_growth is {self.faint_growth:g}.", "Use 0 or more.")
        if not 0 <= self.view_weighting <= 2:
            raise ConfigError(
                f"view_weighting is {self.view_weighting:g}.", "Use a number from 0 to 2."
            )

    def position_learning_rate(self, step: int) -> float:
        """Position learning rate at a step, in units of the scene extent."""
        t = min(step / max(self.steps, 1), 1.0)
        return math.exp((1 - t) * math.log(self.lr_means) + t * math.log(self.lr_means_final))

    @property
    def has_small(self) -> bool:
        """Whether some steps use photos of half the size."""
        return max(self.small_until, self.whole_small_until) > 0

    def is_small(self, step: int) -> bool:
        """Whether a step uses a photo of half the size."""
        whole = is_whole(step, self.full_every)
        return step < (max(self.small_until, self.whole_small_until) if whole else self.small_until)

    @property
    def tells_outside(self) -> bool:
        """Whether Gaussians outside the boxes train in another way than those inside."""
        spares = self.opacity_decay > 0 and self.outside_spared > 0
        return self.full_every > 1 and (spares or self.outside_rate > 0)

    @property
    def prunes_faint(self) -> bool:
        """Whether the stage removes faint Gaussians: it must have added some before."""
        first = -(-max(self.densify_from, 1) // self.densify_every) * self.densify_every
        return self.faint_growth > 0 and first < self.densify_until < self.steps

    def is_averaged(self, step: int) -> bool:
        """Whether the model after so many steps is one of those that are averaged."""
        return step > self.steps - self.average_steps and step % AVERAGE_EVERY == 0

    def is_restarted(self, step: int) -> bool:
        """Whether Adam forgets moments after so many steps; never if the stage does not densify."""
        first, count = self.densify_until, self.restarts
        rest = self.steps - first
        return 0 < first < self.steps and any(
            step == first + k * rest // (count + 1) for k in range(count)
        )

    def is_decayed(self, step: int, photos: int) -> bool:
        """Whether opacities decay after so many steps on so many photos.

        They do so whenever as many steps are done as there are photos, or `DECAY_EVERY` if there
        are fewer; not after the last step, as no photo could give back what is needed.
        """
        return self.opacity_decay > 0 and (
            step < self.steps and step % max(photos, DECAY_EVERY) == 0
        )

    def degree(self, step: int) -> int:
        """SH degree in use at a step."""
        return min(self.sh_degree, self.sh_start + step // max(self.sh_every, 1))


def with_steps(config: TrainConfig, steps: int) -> TrainConfig:
    """The config with `steps` steps, of which the same shares densify, are small and averaged.

    The first densification step and the intervals do not scale: Adam and the statistics need a
    fixed number of steps. `miniature` scales them too.
    """
    shares = ("densify_until", "small_until", "whole_small_until", "average_steps")
    scaled: dict[str, Any] = {
        name: round(getattr(config, name) * steps / config.steps) for name in shares
    }
    return replace(config, steps=steps, **scaled)


def miniature(config: TrainConfig, steps: int) -> TrainConfig:
    """The config with `steps` steps and its whole schedule in proportion.

    So it densifies, raises the SH degree and resets opacities as often as the full schedule, up to
    rounding. An interval keeps at least one step; what is off stays off.
    """
    intervals: dict[str, int] = {name: getattr(config, name) for name in INTERVALS}
    scaled: dict[str, Any] = {
        name: max(1, round(interval * steps / config.steps)) if interval else 0
        for name, interval in intervals.items()
    }
    return replace(with_steps(config, steps), **scaled)
