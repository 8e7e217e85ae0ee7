"""Baselines of the study alone: the tuned one in one stage, and as many Gaussians as ours."""

from __future__ import annotations

from dataclasses import asdict, replace

from roigs_engine.run import stage_configs, strategies
from roigs_engine.run.config import RunConfig
from roigs_engine.run.plan import Plan, PlannedModel
from roigs_engine.run.stages import PhotoSets, make_stage
from roigs_engine.training.config import TrainConfig, with_steps
from roigs_engine.training.mechanisms.background_points import BackgroundPoints
from roigs_engine.training.mechanisms.box_density_control import BoxDensityControl
from roigs_engine.training.mechanisms.density_control import DensityControl


def one_stage(photos: PhotoSets) -> Plan:
    """The tuned Full Scene in one stage on photos of full size."""
    config, rois = one_stage_config(photos.run.config), photos.run.rois
    stage = make_stage("tuned-scene", photos, photos.images, config, rois=rois)
    return Plan(models=(PlannedModel.of_stages("Full Scene, tuned, one stage", stage),))


def one_stage_config(config: RunConfig) -> TrainConfig:
    """The tuned Full Scene's settings over all its steps; densified for as long as 3DGS."""
    tuned, plain = stage_configs.tuned_baseline(config), stage_configs.baseline(config)
    stage = with_steps(tuned.fine, config.total_steps)
    start, until = tuned.coarse.of(DensityControl).start, plain.of(DensityControl).until
    stage = stage.using(replace(stage.of(DensityControl), start=start, until=until))
    mechanisms = (*tuned.coarse.chosen(BackgroundPoints), *stage.mechanisms)
    return replace(stage, sh_start=tuned.coarse.sh_start, mechanisms=mechanisms)


def matched(photos: PhotoSets, budgets: tuple[int, ...], *, tuned: bool) -> Plan:
    """Full Scene with as many Gaussians in each box as our model has there.

    Its gradient threshold in the boxes is a quarter of the box stage's, so that only the budgets
    limit their number: a difference to our model is not due to the number of Gaussians.

    Args:
        photos: of the run.
        budgets: our number of Gaussians in each box.
        tuned: whether it has the tuned Full Scene's settings.
    """
    run = photos.run
    plan = (strategies.full_scene_tuned if tuned else strategies.full_scene)(photos)
    *coarse, stage = plan.models[0].stages
    own = stage.config.of(DensityControl)
    density = BoxDensityControl(
        **asdict(own) | {"grad_threshold": run.config.roi.of(DensityControl).grad_threshold / 4},
        outside_threshold=own.grad_threshold,
        box_sizes=False,
        budgets=budgets,
    )
    name = "tuned-matched" if tuned else "matched-scene"
    stage = replace(stage, name=name, config=stage.config.using(density), rois=run.rois)
    title = "Matched, tuned" if tuned else "Matched"
    return Plan(models=(PlannedModel.of_stages(title, *coarse, stage),))
