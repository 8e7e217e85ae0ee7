"""The settings of each stage, derived from the run's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ..training.config import TrainConfig, miniature, with_steps
from .config import RunConfig
from .presets import in_strategy, joint_recipe

# Whole photos that surroundings get in a stage with masks, in its steps: a third are whole, and the
# masks of the others show much of what is behind the boxes, which may be in another block.
WHOLE_SHARE = 0.6
CUTOUT_SHARE = 0.6  # steps of the stage that cuts objects out, in steps of the box stage
# Of a short stage after the box stage: all Gaussians are there, and stay.
SETTLED: dict[str, Any] = {
    "densify_until": 0,
    "small_until": 0,
    "whole_small_until": 0,
    "near_grad_threshold": 0.0,
    "restarts": 0,
    "opacity_decay": 0.0,
    "box_budget": 0.0,
    "faint_growth": 0.0,
    "outside_spared_spread": 0.0,
    "outside_rate": 0.0,
}
COARSE_TO_FINE = True  # the tuned baselines: a first stage on small photos; False: one stage


@dataclass(frozen=True, kw_only=True)
class TunedBaseline:
    """Settings of a tuned baseline.

    Attributes:
        coarse: of its first stage; None: it has one stage only.
        scale: factor on the size of the photos of the first stage.
        fine: of its last stage, on photos of full size.
    """

    coarse: TrainConfig | None
    scale: float
    fine: TrainConfig


def baseline(config: RunConfig) -> TrainConfig:
    """Full Scene and Full Object: 3DGS over the steps of both stages.

    The intervals are the Scene-GS's, which a miniature of the paper's schedule has scaled.
    """
    return replace(
        config.scene,
        steps=config.total_steps,
        densify_until=_densify_steps(config),
        lr_means_final=TrainConfig.lr_means_final,
        grad_threshold=TrainConfig.grad_threshold,
        reset_every=config.scene.reset_every or TrainConfig.reset_every,
        backdrop_cells=0,
        opacity_decay=0.0,
        faint_growth=0.0,
        restarts=0,
        antialiased=False,
    )


def matched_baseline(config: RunConfig) -> TrainConfig:
    """The baseline with a quarter of the box stage's gradient threshold in the boxes.

    So only the Gaussian budget limits the number of Gaussians there.
    """
    return replace(baseline(config), box_grad_threshold=config.roi.grad_threshold / 4)


def tuned_baseline(config: RunConfig, coarse_to_fine: bool = COARSE_TO_FINE) -> TunedBaseline:
    """The tuned Full Scene and Full Object: 3DGS with all settings of ours that fit any scene.

    These are the joint recipe's, without what boxes bring: masks, weights, budgets, a lower
    threshold; and without small photos in the last stage, by which they lose. With two stages, the
    steps that densify are as many in sum as in the baseline; the last stage densifies for a third
    of its steps at the least, like the joint stage.
    """
    ours = config if config.strategy == "joint" else in_strategy(config, "joint")
    fine = replace(
        ours.roi,
        densify_in_boxes=False,
        outside_grad_threshold=0.0,
        near_grad_threshold=0.0,
        grad_threshold=TrainConfig.grad_threshold,
        box_budget=0.0,
        full_every=1,
        outside_spared_spread=0.0,
        outside_rate=0.0,
        view_weighting=0.0,
        small_until=0,  # they lose a little by it: notebook/sampling.md, "Small photos first"
        whole_small_until=0,
    )
    if coarse_to_fine:
        until = max(_densify_steps(config) - ours.scene.densify_until, ours.roi.steps // 3)
        fine = replace(fine, densify_until=min(until, fine.steps))
        return TunedBaseline(coarse=ours.scene, scale=ours.scene_scale, fine=fine)
    fine = replace(
        with_steps(fine, config.total_steps),
        sh_start=ours.scene.sh_start,
        backdrop_cells=ours.scene.backdrop_cells,
        densify_from=ours.scene.densify_from,
        densify_until=_densify_steps(config),
    )
    return TunedBaseline(coarse=None, scale=1.0, fine=fine)


def tuned_matched_baseline(config: RunConfig) -> TunedBaseline:
    """The tuned baseline with the lower threshold of `matched_baseline` in the boxes."""
    tuned, threshold = tuned_baseline(config), config.roi.grad_threshold / 4
    return replace(tuned, fine=replace(tuned.fine, box_grad_threshold=threshold))


def cutout_stage(config: RunConfig) -> TrainConfig:
    """The stage that makes objects look right alone: the box stage's settings at its end."""
    steps = max(1, round(CUTOUT_SHARE * config.roi.steps))
    return replace(
        config.roi,
        steps=steps,
        sh_start=config.roi.sh_degree,
        lr_means=config.roi.lr_means / 10,
        **SETTLED,
        min_views=0,
        average_steps=steps // 2,
    )


def shortened(config: TrainConfig, share: float) -> TrainConfig:
    """A stage on a share of the photos: so much of its steps, and of the intervals between them.

    So each photo is used as often as in the whole stage, a Gaussian is seen as often between two
    densifications, and there are as many of these, whatever rounding does.
    """
    short = miniature(config, max(1, round(share * config.steps)))
    ratio = short.densify_every / config.densify_every
    begin, end = (round(ratio * step) for step in (config.densify_from, config.densify_until))
    return replace(short, densify_from=begin, densify_until=min(end, short.steps))


def surroundings_stage(config: TrainConfig, share: float) -> TrainConfig:
    """A stage of a part of the scene without boxes, on a share of the photos: whole photos only."""
    whole = replace(
        config,
        densify_in_boxes=False,
        grad_threshold=config.outside_grad_threshold or config.grad_threshold,
        densify_until=config.densify_until if _grows_outside(config) else 0,
        outside_grad_threshold=0.0,
        near_grad_threshold=0.0,
        backdrop_cells=0,  # other parts of the scene are behind it
        opacity_decay=0.0,  # and other photos show it
        lr_shN_spacing=0.0,
        box_budget=0.0,
        full_every=1,
        outside_spared_spread=0.0,
        outside_rate=0.0,
        view_weighting=0.0,
        min_views=0,
    )
    return shortened(whole, share * (1 if config.full_every == 1 else WHOLE_SHARE))


def block_stage(config: TrainConfig, share: float, photos: float) -> TrainConfig:
    """A stage of the boxes of a block and of its surroundings.

    Args:
        config: of the stage of a whole scene.
        share: of the photos that see boxes, those that see this block's.
        photos: share of all photos that the block has.
    """
    config = replace(
        config,
        opacity_decay=0.0,  # other photos show what is beside the block
        outside_spared_spread=0.0,
        outside_rate=0.0,  # and of its whole photos, each has nearly twice as many steps
    )
    if config.full_every == 1:
        return shortened(config, max(share, photos))
    masked = (1 - 1 / config.full_every) * share
    whole = WHOLE_SHARE * photos
    every = max(2, round((masked + whole) / whole))
    return shortened(replace(config, full_every=every), masked + whole)


def _grows_outside(config: TrainConfig) -> bool:
    """Whether a stage densifies outside its boxes."""
    return not config.densify_in_boxes or config.outside_grad_threshold > 0


def _densify_steps(config: RunConfig) -> int:
    """How many steps of a baseline densify."""
    return int(config.baseline_densify * config.total_steps + 1e-9)


def object_stage(config: RunConfig) -> TrainConfig:
    """An Object-GS: the box stage without the steps of the joint refinement."""
    return with_steps(config.roi, config.roi.steps - config.refine_steps)


def refine_stage(config: RunConfig) -> TrainConfig:
    """The joint refinement of a merged model: the joint stage's settings, no new Gaussians."""
    return replace(
        joint_recipe("", config.scene.steps, config.roi.steps).roi,
        steps=config.refine_steps,
        sh_degree=config.roi.sh_degree,
        sh_start=config.roi.sh_degree,
        **SETTLED,
        average_steps=config.refine_steps // 2,
        antialiased=config.roi.antialiased,
    )
