"""The settings of each stage, from those of the run."""

from __future__ import annotations

from dataclasses import replace

from ..training.config import TrainConfig, with_steps
from .config import RunConfig
from .presets import joint_recipe


def baseline(config: RunConfig) -> TrainConfig:
    """Full Scene and Full Object: 3DGS over the steps of both stages.

    It densifies for the first half, as 3DGS does (15K of 30K).
    """
    return replace(
        config.scene,
        steps=config.total_steps,
        densify_until=config.total_steps // 2,
        lr_means_final=TrainConfig.lr_means_final,
        grad_threshold=TrainConfig.grad_threshold,
        reset_every=TrainConfig.reset_every,
    )


def matched_baseline(config: RunConfig) -> TrainConfig:
    """The baseline, densified in the boxes more readily than the ROI stage is.

    Only the number of Gaussians allowed there should limit it, so the threshold is a quarter.
    """
    return replace(baseline(config), box_grad_threshold=config.roi.grad_threshold / 4)


def object_stage(config: RunConfig) -> TrainConfig:
    """An Object-GS: the ROI stage's steps without those of the joint refinement."""
    return with_steps(config.roi, config.roi.steps - config.refine_steps)


def refine_stage(config: RunConfig) -> TrainConfig:
    """The joint refinement of a composed model: the joint stage's settings, no new Gaussians."""
    return replace(
        joint_recipe("", config.scene.steps, config.roi.steps).roi,
        steps=config.refine_steps,
        sh_degree=config.roi.sh_degree,
        sh_start=config.roi.sh_degree,
        densify_until=0,
        box_budget=0.0,
        average_steps=config.refine_steps // 2,
    )
