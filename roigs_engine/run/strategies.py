"""Strategies and baselines: functions that turn a run's photos into plans."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from ..context import QUIET, Context
from ..evaluation.scores import FULL_SCENE, FULL_SCENE_TUNED
from ..formats import run_files
from ..formats.text import json_digest
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from ..requests.choices import STRATEGIES
from . import stage_configs
from .definition import Run
from .plan import CROP, MERGE, Output, Plan, PlannedModel, Source, Stage, result_of
from .presets import in_strategy
from .stages import (
    PhotoSets,
    make_stage,
    scene_model,
    scene_stage,
    seen_part,
    trained_on,
)


def plan_run(run: Run, compare: Sequence[str] = (), context: Context = QUIET) -> Plan:
    """Plan a run: the models to compare with, then its own strategy; its result is last.

    Args:
        run: the run.
        compare: models to compare with, of `choices.COMPARISONS`: baselines, other strategies.
        context: receives the selection's warnings.

    Raises:
        SceneError: no photo is left to train a stage on.
        RoiError: no photo sees a box.
    """
    photos = PhotoSets(run, context)
    plan = Plan()
    for name, baseline in BASELINES.items():
        if name in compare:
            plan += baseline(photos)
    for name in STRATEGIES:
        if name in compare and name != run.config.strategy:
            other = replace(run, config=in_strategy(run.config, name))
            plan += strategy(PhotoSets(other, context, folder=run_files.COMPARED + name))
    return plan + strategy(photos)


def strategy(photos: PhotoSets, *, coarse: Stage | None = None) -> Plan:
    """Plan the run's strategy, from the Scene-GS `coarse` or the run's own."""
    scene = PlannedModel.of_stages("", coarse) if coarse else scene_model(photos)
    make = _joint if photos.run.config.strategy == "joint" else _independent
    models = make(photos, scene)
    return Plan(
        models=models,
        outputs=(Output(folder=photos.folder, model=models[-1], coarse=scene.source),),
        selections={photos.folder: photos.selections()},
    )


def plan_surface(run: Run, context: Context = QUIET) -> Plan:
    """Plan a run, followed by a stage that turns the result into a surface (ours).

    That model is only for meshes; no file of the result is made from it. Raises as `plan_run`.
    """
    photos = PhotoSets(run, context)
    plan = strategy(photos)
    result = plan.models[-1]
    config = stage_configs.surface_stage(photos.run.config)
    last = trained_on(run_files.SURFACE_STAGE, photos, config, result.source)
    return replace(plan, models=(*plan.models, _after("Surface", result, last)))


def _joint(photos: PhotoSets, scene: PlannedModel) -> tuple[PlannedModel, ...]:
    """One stage for all boxes and all photos, densified in the boxes (ours).

    If there are several groups of boxes or several blocks, each has a stage.
    """
    run = photos.run
    start = scene.source if run.config.roi_init == "scene" else None
    joint = trained_on(run_files.JOINT_STAGE, photos, run.config.roi, start)
    models = (replace(scene, name="Scene-GS (joint)"), _after("Joint", scene, joint))
    if not _object_masks(run):
        return models
    config = stage_configs.cutout_stage(run.config)
    last = trained_on(run_files.CUTOUT_STAGE, photos, config, joint.source)
    return (*models, _after("Joint, cut out", models[-1], last))


def _after(name: str, before: PlannedModel, last: PlannedModel) -> PlannedModel:
    """The last model, with the stages of the model before it."""
    stages = tuple(dict.fromkeys((*before.stages, *last.stages)))
    return replace(last, name=name, stages=stages, by_roi=before.by_roi)


def _independent(photos: PhotoSets, scene: PlannedModel) -> tuple[PlannedModel, ...]:
    """The paper's strategy: an Object-GS for each box, then composition.

    With `refine_share`, a joint refinement follows (ours): the merged model is trained further, so
    that its parts fit together.
    """
    run = photos.run
    stages = {roi.name: _object_stage(photos, scene.source, roi) for roi in run.rois}
    source = Source(
        kind=MERGE,
        base=scene.source,
        inputs=tuple(stages.values()),
        rois=run.rois,
        digest=_object_masks(run),
    )
    by_roi: dict[str, tuple[Stage, ...]] = {roi: (stage,) for roi, stage in stages.items()}
    composed = replace(scene, name="Composition", source=source, by_roi=by_roi)
    models = [
        replace(scene, name="Scene-GS"),
        *(PlannedModel.of_stages("Object-GS", stage, roi=roi) for roi, stage in stages.items()),
        composed,
    ]
    if run.config.refine_steps:
        config = stage_configs.refine_stage(run.config)
        refined = trained_on(run_files.REFINE_STAGE, photos, config, composed.source)
        models.append(_after("Composition, refined", composed, refined))
    return tuple(models)


def _object_stage(photos: PhotoSets, scene: Source, roi: OrientedBox) -> Stage:
    """The Object-GS of one box (paper, sec. II-B): its selected photos, densified in the box."""
    run = photos.run
    by_name = {image.name: image for image in photos.images}
    images = tuple(by_name[name] for name in photos.selection(roi).names)
    start = None  # start from the sparse points: an ablation of the paper
    if run.config.roi_init == "box":  # another ablation of the paper
        start = Source(kind=CROP, base=scene, rois=(roi,))
    elif run.config.roi_init == "scene":
        start = seen_part(run, scene, images)
    return make_stage(
        f"{run_files.OBJECT_STAGE}{roi.name}",
        photos,
        images,
        stage_configs.object_stage(run.config),
        rois=(roi,),
        start=start,
        order=run.config.roi_order,
    )


def _object_masks(run: Run) -> str:
    """Hash of the masks of boxes' objects for the training photos; empty: there are none."""
    found = [
        (image.name, index, image.objects[roi.name].digest)
        for image in run.train_scene.images
        for index, roi in enumerate(run.rois)
        if roi.name in image.objects
    ]
    return json_digest(found) if found else ""


def full_scene(photos: PhotoSets) -> Plan:
    """Baseline: standard 3DGS on all training photos, for the steps of both stages."""
    config = stage_configs.baseline(photos.run.config)
    stage = make_stage(run_files.FULL_SCENE_STAGE, photos, photos.images, config)
    return Plan(models=(PlannedModel.of_stages(FULL_SCENE, stage),))


def full_objects(photos: PhotoSets) -> Plan:
    """Baseline of each box: standard 3DGS on all photos that see the box."""
    config = stage_configs.baseline(photos.run.config)
    models = []
    for roi in photos.run.rois:
        name = run_files.FULL_OBJECT_STAGE + roi.name
        stage = make_stage(name, photos, photos.seen(roi), config)
        models.append(PlannedModel.of_stages("Full Object", stage, roi=roi.name))
    return Plan(models=tuple(models))


def full_scene_tuned(photos: PhotoSets) -> Plan:
    """Baseline: Full Scene with our settings, minus those that need boxes.

    Boxes only decide which points' colours are compared, and limit the consistency test.
    """
    config = stage_configs.tuned_baseline(photos.run.config)
    stages = _tuned(photos, run_files.SCENE_STAGE, photos.images, config, photos.run.rois)
    return Plan(models=(PlannedModel.of_stages(FULL_SCENE_TUNED, *stages),))


def full_objects_tuned(photos: PhotoSets) -> Plan:
    """Baseline of each box: as `full_scene_tuned`, on all photos that see the box."""
    config = stage_configs.tuned_baseline(photos.run.config)
    models = []
    for roi in photos.run.rois:
        name = run_files.OBJECT_STAGE + roi.name
        stages = _tuned(photos, name, photos.seen(roi), config, (roi,))
        models.append(PlannedModel.of_stages("Full Object, tuned", *stages, roi=roi.name))
    return Plan(models=tuple(models))


def _tuned(
    photos: PhotoSets,
    name: str,
    images: tuple[PosedImage, ...],
    config: stage_configs.TunedBaseline,
    rois: Sequence[OrientedBox],
) -> tuple[Stage, Stage]:
    """The stages of a tuned baseline.

    Baselines on the same photos share their first stage; it may be the run's own Scene-GS.
    """
    small = tuple(image.scaled(config.scale) for image in images)
    whole = len(images) == len(photos.images)
    first = run_files.TUNED_COARSE_STAGE + (run_files.SCENE_STAGE if whole else name)
    coarse = make_stage(first, photos, small, config.coarse)
    if photos.run.config.scene == config.coarse:
        own = scene_stage(photos)
        coarse = own if own.fingerprint == coarse.fingerprint else coarse
    fine = run_files.TUNED_STAGE + name
    return coarse, make_stage(fine, photos, images, config.fine, rois=rois, start=result_of(coarse))


BASELINES: Mapping[str, Callable[[PhotoSets], Plan]] = {
    "full-scene": full_scene,
    "full-scene-tuned": full_scene_tuned,
    "full-object": full_objects,
    "full-object-tuned": full_objects_tuned,
}
