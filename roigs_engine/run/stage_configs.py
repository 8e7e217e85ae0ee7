"""The settings of each stage, derived from the run's."""

from __future__ import annotations

from dataclasses import replace

from ..training.config import TrainConfig, with_steps
from .config import RunConfig
from .presets import joint_recipe


def baseline(config: RunConfig) -> TrainConfig:
    """Full Scene and Full Object: 3DGS over the steps of both stages.

    The intervals are the Scene-GS's, which a miniature of the paper's schedule has scaled.
    """
    return replace(
        config.scene,
        steps=config.total_steps,
        densify_until=int(config.baseline_densify * config.total_steps + 1e-9),
        lr_means_final=TrainConfig.lr_means_final,
        grad_threshold=TrainConfig.grad_threshold,
        reset_every=config.scene.reset_every or TrainConfig.reset_every,
    )


def matched_baseline(config: RunConfig) -> TrainConfig:
    """The baseline with a quarter of the box stage's gradient threshold in the boxes.

    So only the Gaussian budget limits the number of Gaussians there.
    """
    return replace(baseline(config), box_grad_threshold=config.roi.grad_threshold / 4)


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
        densify_until=0,
        box_budget=0.0,
        average_steps=config.refine_steps // 2,
    )
