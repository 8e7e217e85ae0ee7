"""Strategies and baselines: functions that turn a run's photos into plans."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import starmap

from ..context import QUIET, Context
from ..errors import SceneError
from ..evaluation.scores import FULL_SCENE, FULL_SCENE_TUNED
from ..formats import run_files
from ..formats.text import json_digest
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from ..training.budget import box_budgets
from ..training.config import TrainConfig
from ..training.photo_order import PhotoOrder
from ..training.view_spacing import detail_spacing, learning_rates_for_spacing, view_spacing
from . import stage_configs
from .config import STRATEGIES
from .definition import Run
from .photo_sets import PhotoSets
from .plan import CROP, MERGE, POINTS, Output, Plan, PlannedModel, Source, Stage, result_of
from .presets import in_strategy

BASELINE, TUNED = FULL_SCENE, FULL_SCENE_TUNED


def plan_run(run: Run, compare: Sequence[str] = (), context: Context = QUIET) -> Plan:
    """The plan of a run: the models to compare with, then its own strategy, its result last.

    Args:
        run: the run.
        compare: models to compare with, from `config.COMPARISONS`: baselines, other strategies.
        context: receives the selection's warnings; checked for cancellation.

    Raises:
        SceneError: no photo is left to train a stage on.
        RoiError: no photo sees a box.
    """
    photos = PhotoSets(run, context)
    plan = Plan()
    if "full-scene" in compare:
        plan += full_scene(photos)
    if "full-scene-tuned" in compare:
        plan += full_scene_tuned(photos)
    if "full-object" in compare:
        plan += full_objects(photos)
    if "full-object-tuned" in compare:
        plan += full_objects_tuned(photos)
    for name in STRATEGIES:
        if name in compare and name != run.config.strategy:
            other = replace(run, config=in_strategy(run.config, name))
            plan += strategy(PhotoSets(other, context), folder=run_files.COMPARED + name)
    return plan + strategy(photos)


def full_scene(photos: PhotoSets) -> Plan:
    """Baseline: standard 3DGS on all training photos, for the steps of both stages."""
    config = stage_configs.baseline(photos.run.config)
    stage = _stage(run_files.FULL_SCENE_STAGE, photos, photos.images, config)
    return Plan(models=(PlannedModel.of_stages(BASELINE, stage),))


def full_objects(photos: PhotoSets) -> Plan:
    """Baseline of each box: standard 3DGS on all photos that see the box."""
    config = stage_configs.baseline(photos.run.config)
    models = []
    for roi in photos.run.rois:
        stage = _stage(f"{run_files.FULL_OBJECT_STAGE}{roi.name}", photos, photos.seen(roi), config)
        models.append(PlannedModel.of_stages("Full Object", stage, roi=roi.name))
    return Plan(models=tuple(models))


def matched(photos: PhotoSets, ours: PlannedModel) -> Plan:
    """Baseline: Full Scene with as many Gaussians in each box as our model has there.

    Its gradient threshold in the boxes is lower than the box stage's, so that it reaches that
    number: a difference to our model is not due to the number of Gaussians.
    """
    run = photos.run
    config = stage_configs.matched_baseline(run.config)
    stage = _stage(run_files.MATCHED_STAGE, photos, photos.images, config, rois=run.rois)
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
        return (_stage(fine, photos, images, config.fine, rois=rois),)
    small = tuple(image.scaled(config.scale) for image in images)
    whole = len(images) == len(photos.images)
    first = run_files.TUNED_COARSE_STAGE + (run_files.SCENE_STAGE if whole else name)
    coarse = _stage(first, photos, small, config.coarse)
    if photos.run.config.scene == config.coarse:
        own = scene_stage(photos)
        coarse = own if own.fingerprint == coarse.fingerprint else coarse
    last = _stage(fine, photos, images, config.fine, rois=rois, start=result_of(coarse))
    return coarse, last


def strategy(photos: PhotoSets, *, folder: str = "", coarse: Stage | None = None) -> Plan:
    """The plan of the run's strategy.

    Args:
        photos: of the run.
        folder: folder of its stages and files, below the run folder.
        coarse: a Scene-GS to start from; None: the run's own.
    """
    scene = coarse or scene_stage(photos, folder)
    make = _joint if photos.run.config.strategy == "joint" else _independent
    models = make(photos, scene, folder)
    return Plan(
        models=models,
        outputs=(Output(folder=folder, model=models[-1], coarse=scene),),
        selections={folder: photos.selections()},
    )


def scene_stage(photos: PhotoSets, folder: str = "") -> Stage:
    """Scene-GS (paper, sec. II-B): all photos except those reserved for the boxes."""
    config, reserved = photos.run.config, photos.reserved()
    kept = tuple(image for image in photos.images if image.name not in reserved)
    if not kept:
        raise SceneError(
            "All photos are reserved for boxes: none is left to train the scene on.",
            "Raise --kept-share (1 keeps all), or select fewer photos (--count).",
        )
    images = tuple(image.scaled(config.scene_scale) for image in kept)
    return _stage(_path(folder, run_files.SCENE_STAGE), photos, images, config.scene)


def _joint(photos: PhotoSets, scene: Stage, folder: str) -> tuple[PlannedModel, ...]:
    """One stage for all boxes and all photos, densified in the boxes (ours)."""
    run = photos.run
    joint = _stage(
        _path(folder, run_files.JOINT_STAGE),
        photos,
        photos.images,
        run.config.roi,
        rois=run.rois,
        start=_roi_start(run, scene, run.rois),
        order=_mixed_order,
    )
    models = (
        PlannedModel.of_stages("Scene-GS (joint)", scene),
        PlannedModel.of_stages("Joint", scene, joint),
    )
    if not _object_masks(run):
        return models
    last = _cutout_stage(photos, result_of(joint), folder)
    return (*models, PlannedModel.of_stages("Joint, cut out", scene, joint, last))


def _cutout_stage(photos: PhotoSets, start: Source, folder: str) -> Stage:
    """Trains a model on so that its objects look right alone (ours)."""
    stage = _stage(
        _path(folder, run_files.CUTOUT_STAGE),
        photos,
        photos.images,
        stage_configs.cutout_stage(photos.run.config),
        rois=photos.run.rois,
        start=start,
        order=_mixed_order,
    )
    return replace(stage, cutouts=True)


def _independent(photos: PhotoSets, scene: Stage, folder: str) -> tuple[PlannedModel, ...]:
    """The paper's strategy: an Object-GS for each box, then composition.

    With `refine_share`, a joint refinement follows (ours).
    """
    run = photos.run
    stages = [_object_stage(photos, scene, roi, folder) for roi in run.rois]
    objects: dict[str, tuple[Stage, ...]] = {
        roi.name: (stage,) for roi, stage in zip(run.rois, stages, strict=True)
    }
    composed = Source(kind=MERGE, inputs=(scene, *stages), rois=run.rois, digest=_object_masks(run))
    models = [
        PlannedModel.of_stages("Scene-GS", scene),
        *(PlannedModel.of_stages("Object-GS", *own, roi=roi) for roi, own in objects.items()),
        PlannedModel(name="Composition", source=composed, stages=(scene,), by_roi=objects),
    ]
    if run.config.refine_steps:
        refined = _refine_stage(photos, composed, folder)
        models.append(
            PlannedModel(
                name="Composition, refined",
                source=result_of(refined),
                stages=(scene, refined),
                by_roi=objects,
            )
        )
    return tuple(models)


def _object_stage(photos: PhotoSets, scene: Stage, roi: OrientedBox, folder: str) -> Stage:
    """Object-GS of one box (paper, sec. II-B): its selected photos, densified in the box."""
    run = photos.run
    by_name = {image.name: image for image in photos.images}
    return _stage(
        _path(folder, f"{run_files.OBJECT_STAGE}{roi.name}"),
        photos,
        tuple(by_name[name] for name in photos.selection(roi).names),
        stage_configs.object_stage(run.config),
        rois=(roi,),
        start=_roi_start(run, scene, (roi,)),
        order=_in_order if run.config.roi_order == "ordered" else _shuffled_order,
    )


def _refine_stage(photos: PhotoSets, composed: Source, folder: str) -> Stage:
    """Joint refinement (ours): trains the merged model on, so that its parts fit together."""
    return _stage(
        _path(folder, run_files.REFINE_STAGE),
        photos,
        photos.images,
        stage_configs.refine_stage(photos.run.config),
        rois=photos.run.rois,
        start=composed,
        order=_mixed_order,
    )


Order = Callable[[PhotoSets, Sequence[PosedImage], TrainConfig], PhotoOrder]


def _shuffled_order(
    photos: PhotoSets, images: Sequence[PosedImage], config: TrainConfig
) -> PhotoOrder:
    """All photos equally often, in random order."""
    return PhotoOrder(kind="shuffled", count=len(images), seed=photos.run.config.seed)


def _in_order(photos: PhotoSets, images: Sequence[PosedImage], config: TrainConfig) -> PhotoOrder:
    """The photos in the order given (paper, sec. III-A)."""
    return PhotoOrder(kind="ordered", count=len(images))


def _mixed_order(
    photos: PhotoSets, images: Sequence[PosedImage], config: TrainConfig
) -> PhotoOrder:
    """Selected photos more often than others."""
    selected = photos.selected()
    all_rows = tuple(range(len(images)))
    return PhotoOrder(
        kind="mixed",
        count=len(images),
        seed=photos.run.config.seed,
        selected=tuple(row for row, image in enumerate(images) if image.name in selected),
        drawn=all_rows if config.full_every == 1 else photos.rows_seeing(images),
        share=photos.run.config.selected_share,
        full_every=config.full_every,
    )


def _stage(
    name: str,
    photos: PhotoSets,
    images: tuple[PosedImage, ...],
    config: TrainConfig,
    *,
    rois: Sequence[OrientedBox] = (),
    start: Source | None = None,
    order: Order = _shuffled_order,
) -> Stage:
    """A stage; its budgets, masks and SH learning rate follow from its photos and boxes."""
    run = photos.run
    if config.lr_shN_spacing:
        seen = [(photos.seen(roi), roi) for roi in rois]
        spacing, detail = (max(starmap(f, seen)) for f in (view_spacing, detail_spacing))
        config = learning_rates_for_spacing(config, spacing, detail)
    margins = tuple(roi.scaled(config.box_margin) for roi in rois)
    return Stage(
        name=name,
        images=images,
        config=config,
        start=start or _points(run),
        order=order(photos, images, config),
        rois=margins,
        budgets=box_budgets(images, margins, config, photos.context),
        seeing=() if config.full_every == 1 else photos.rows_seeing(images),
        extent=run.extent,
        seed=run.config.seed,
    )


def _points(run: Run) -> Source:
    scene = run.train_scene
    digest = hashlib.sha256(scene.points.tobytes() + scene.colors.tobytes()).hexdigest()
    return Source(kind=POINTS, digest=digest)


def _object_masks(run: Run) -> str:
    """Hash of the masks of the boxes' objects on the training photos; empty: there are none."""
    found = [
        (image.name, index, image.objects[roi.name].digest)
        for image in run.train_scene.images
        for index, roi in enumerate(run.rois)
        if roi.name in image.objects
    ]
    return json_digest(found) if found else ""


def _roi_start(run: Run, scene: Stage, rois: Sequence[OrientedBox]) -> Source:
    """What the box stage starts from: the Scene-GS, or an ablation's choice."""
    match run.config.roi_init:
        case "points":
            return _points(run)
        case "box":
            return Source(kind=CROP, inputs=(scene,), rois=tuple(rois))
        case _:
            return result_of(scene)


def _path(folder: str, stage: str) -> str:
    return f"{folder}/{stage}" if folder else stage
