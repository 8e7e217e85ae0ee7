"""Baselines: plans of models to compare a run with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..evaluation.scores import FULL_SCENE, FULL_SCENE_TUNED
from ..formats import run_files
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from . import stage_configs
from .photo_sets import PhotoSets
from .plan import Plan, PlannedModel, Stage, result_of
from .scene_stages import scene_stage
from .stages import make_stage

BASELINE, TUNED = FULL_SCENE, FULL_SCENE_TUNED


def full_scene(photos: PhotoSets) -> Plan:
    """Baseline: standard 3DGS on all training photos, for the steps of both stages."""
    config = stage_configs.baseline(photos.run.config)
    stage = make_stage(run_files.FULL_SCENE_STAGE, photos, photos.images, config)
    return Plan(models=(PlannedModel.of_stages(BASELINE, stage),))


def full_objects(photos: PhotoSets) -> Plan:
    """Baseline of each box: standard 3DGS on all photos that see the box."""
    config = stage_configs.baseline(photos.run.config)
    models = []
    for roi in photos.run.rois:
        stage = make_stage(
            f"{run_files.FULL_OBJECT_STAGE}{roi.name}", photos, photos.seen(roi), config
        )
        models.append(PlannedModel.of_stages("Full Object", stage, roi=roi.name))
    return Plan(models=tuple(models))


def matched(photos: PhotoSets, ours: PlannedModel) -> Plan:
    """Baseline: Full Scene with as many Gaussians in each box as our model has there.

    Its gradient threshold in the boxes is lower than the box stage's, so that it reaches that
    number: a difference to our model is not due to the number of Gaussians.
    """
    run = photos.run
    config = stage_configs.matched_baseline(run.config)
    stage = make_stage(run_files.MATCHED_STAGE, photos, photos.images, config, rois=run.rois)
    stage = replace(stage, matched=ours.source)
    return Plan(models=(PlannedModel.of_stages("Matched", stage),))


def full_scene_tuned(
    photos: PhotoSets, *, coarse_to_fine: bool = stage_configs.COARSE_TO_FINE
) -> Plan:
    """Baseline: Full Scene with every setting of ours that fits any scene.

    Boxes are used for the view spacing and the consistency test only.
    """
    config = stage_configs.tuned_baseline(photos.run.config, coarse_to_fine)
    stages = _tuned(photos, run_files.SCENE_STAGE, photos.images, config, photos.run.rois)
    return Plan(models=(PlannedModel.of_stages(TUNED, *stages),))


def full_objects_tuned(photos: PhotoSets) -> Plan:
    """Baseline of each box: as `full_scene_tuned`, on all photos that see the box."""
    config = stage_configs.tuned_baseline(photos.run.config)
    models = []
    for roi in photos.run.rois:
        name = f"{run_files.OBJECT_STAGE}{roi.name}"
        stages = _tuned(photos, name, photos.seen(roi), config, (roi,))
        models.append(PlannedModel.of_stages("Full Object, tuned", *stages, roi=roi.name))
    return Plan(models=tuple(models))


def matched_tuned(photos: PhotoSets, ours: PlannedModel) -> Plan:
    """Baseline: as `matched`, of the tuned Full Scene."""
    config = stage_configs.tuned_matched_baseline(photos.run.config)
    *coarse, fine = _tuned(photos, "matched", photos.images, config, photos.run.rois)
    fine = replace(fine, matched=ours.source)
    return Plan(models=(PlannedModel.of_stages("Matched, tuned", *coarse, fine),))


def _tuned(
    photos: PhotoSets,
    name: str,
    images: tuple[PosedImage, ...],
    config: stage_configs.TunedBaseline,
    rois: Sequence[OrientedBox],
) -> tuple[Stage, ...]:
    """The stages of a tuned baseline.

    Baselines on the same photos share their first stage; it may be the run's own Scene-GS.
    """
    fine = run_files.TUNED_STAGE + name
    if config.coarse is None:
        return (make_stage(fine, photos, images, config.fine, rois=rois),)
    small = tuple(image.scaled(config.scale) for image in images)
    whole = len(images) == len(photos.images)
    first = run_files.TUNED_COARSE_STAGE + (run_files.SCENE_STAGE if whole else name)
    coarse = make_stage(first, photos, small, config.coarse)
    if photos.run.config.scene == config.coarse:
        own = scene_stage(photos)
        coarse = own if own.fingerprint == coarse.fingerprint else coarse
    last = make_stage(fine, photos, images, config.fine, rois=rois, start=result_of(coarse))
    return coarse, last
