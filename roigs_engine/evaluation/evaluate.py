"""Compares renders with test photos: the paper's table for every box, with more columns.

docs/method.md, "Evaluation", describes the masks, which are the same for every row of a box. PSNR
is computed per view and then averaged. Renders are clamped to [0, 1] but not rounded to 8 bits.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError, SceneError
from ..formats.events import StageStarted
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import PosedImage, SfmScene
from ..photos.headers import PhotoError
from . import metrics
from .scores import (
    FULL_SCENE,
    FULL_SCENE_TUNED,
    MIN_OBJECT,
    Evaluation,
    Gains,
    ModelScore,
    RoiScores,
    ViewScore,
    mean,
    near_and_far,
)
from .views import BoxPlan, EvaluatedModel, Sample, measure_view, plan_views


def evaluate(
    models: Sequence[EvaluatedModel],
    scene: SfmScene,
    test: Sequence[str],
    rois: Sequence[OrientedBox],
    *,
    context: Context = QUIET,
    baseline: str | None = None,
    object_mask_from: str | None = None,
    photos: str = "test",
) -> Evaluation:
    """Evaluate every model on the test photos.

    Each test view is rendered once per model and not kept. The object's mask depends on the best
    model, which is known only at the end. So each view's errors are summed in the masks from all
    models' depths, and the sums of the best model's mask are used at the end.

    Args:
        models: the models, one row each.
        scene: with the photos.
        test: names of the test photos.
        rois: the boxes.
        context: receives progress.
        baseline: name of the model for computing gains; None for the tuned Full Scene if there is
            one, else Full Scene.
        object_mask_from: name of the model whose depth defines the object's mask; None for the
            best one. Use the same model in evaluations that are compared.
        photos: kind of these photos, `test` or `validation`.

    Raises:
        SceneError: there is no test photo, none can be read, or one is not in the scene.
        ConfigError: there is no model, two models of a box share a name, or a box has no model
            `object_mask_from`.
    """
    images = _checked(models, scene, test, photos)
    if baseline is None:
        tuned = any(model.name == FULL_SCENE_TUNED for model in models)
        baseline = FULL_SCENE_TUNED if tuned else FULL_SCENE
    plans = [plan_views(roi, images, models, object_mask_from, context, photos) for roi in rois]
    samples, image_views = _measure(models, images, plans, context)
    names = tuple(image.name for image in images if image.name in image_views[models[0]])
    if not names:
        raise SceneError(f"No {photos} photo can be read.", "Restore the photos' files.")
    plans = [plan.only(names) for plan in plans]
    tables = [_table(p, s, image_views, baseline) for p, s in zip(plans, samples, strict=True)]
    masked = sum(image.name in names and image.mask is not None for image in images)
    return Evaluation(
        test_views=names, baseline=baseline, rois=tuple(tables), photos=photos, masked=masked
    )


def _measure(
    models: Sequence[EvaluatedModel],
    images: Sequence[PosedImage],
    plans: Sequence[BoxPlan],
    context: Context,
) -> tuple[list[dict[str, Sample]], dict[EvaluatedModel, dict[str, float]]]:
    """Return the samples of each box by photo, and PSNR of each model's whole images by photo.

    Photos that cannot be read any more are left out, with a warning.
    """
    samples: list[dict[str, Sample]] = [{} for _ in plans]
    image_views: dict[EvaluatedModel, dict[str, float]] = {model: {} for model in models}
    context.emit(StageStarted(stage="evaluate", total=len(images)))
    started = time.monotonic()
    for step, image in enumerate(images, start=1):
        try:
            whole, measured = measure_view(models, image, plans, context)
        except PhotoError as error:  # the photo was readable when the run began
            context.warn(f"{error.message} The evaluation leaves it out.")
            continue
        for model, value in whole.items():
            image_views[model][image.name] = value
        for store, sample in zip(samples, measured, strict=True):
            if sample is not None:
                store[image.name] = sample
        context.progress(
            "evaluate",
            step,
            len(images),
            started,
            psnr=max(whole.values()),
            gaussians=max(len(model.gaussians) for model in models),
        )
    return samples, image_views


def ply_bytes(gaussians: Gaussians) -> int:
    """Return the size of a model's PLY without header: 14 + 3 K float32 values per Gaussian."""
    return 4 * len(gaussians) * (14 + 3 * gaussians.sh.shape[1])


def _checked(
    models: Sequence[EvaluatedModel], scene: SfmScene, test: Sequence[str], photos: str
) -> list[PosedImage]:
    """Return the photos to measure, in the scene's order."""
    if not models:
        raise ConfigError("There is no model to evaluate.", "Give at least one PLY.")
    unknown = set(test) - {image.name for image in scene.images}
    if unknown:
        what = f"{photos.capitalize()} photo '{min(unknown)}'"
        raise SceneError(f"{what} is not in the scene.", "Remove its name.")
    if not test:
        raise SceneError(f"There is no {photos} photo.", "Set test_every.")
    return list(scene.select(set(test)).images)


def _table(
    plan: BoxPlan,
    samples: dict[str, Sample],
    image_views: dict[EvaluatedModel, dict[str, float]],
    baseline: str,
) -> RoiScores:
    """Make one box's table from the samples of all views."""
    names = [model.name for model in plan.models]
    means = [mean([s.scores[k].roi_psnr for s in samples.values()]) for k in range(len(names))]
    scored = [k for k, value in enumerate(means) if value is not None]
    best = max(scored, key=lambda k: means[k] or 0.0) if scored else None
    if best is not None and plan.mask_from is not None:
        best = plan.mask_from
    base = names.index(baseline) if baseline in names else None
    views = tuple(
        dataclasses.replace(view, object_pixels=0 if best is None else samples[name].pixels[best])
        for name, view in plan.views.items()
    )
    rows = tuple(
        _row(plan, index, samples, best, base, image_views[model])
        for index, model in enumerate(plan.models)
    )
    return RoiScores(
        roi=plan.roi.name,
        views=views,
        left_out=plan.left_out,
        object_mask_from=None if best is None else names[best],
        rows=rows,
    )


def _row(
    plan: BoxPlan,
    index: int,
    samples: dict[str, Sample],
    best: int | None,
    base: int | None,
    image_views: dict[str, float],
) -> ModelScore:
    """Make the row of model `index`; model `best` defines the object's mask; `base`: baseline."""
    model = plan.models[index]
    views = []
    for sample in samples.values():
        score = sample.scores[index]
        if best is not None and sample.pixels[best] >= MIN_OBJECT:
            psnr = metrics.psnr_from_mse(sample.object_mse[index][best])
            score = dataclasses.replace(score, object_psnr=psnr)
        views.append(score)
    thirds = near_and_far({v.view: v.distance for v in views if v.distance is not None})
    near, far = ([view for view in views if view.view in third] for third in thirds)
    gains = Gains()
    if base is not None and base != index:
        before = {name: sample.scores[base].roi_psnr for name, sample in samples.items()}
        gains = Gains.of({view.view: view.roi_psnr - before[view.view] for view in views})

    def average(views: Sequence[ViewScore], key: str) -> float | None:
        return mean([value for view in views if (value := getattr(view, key)) is not None])

    return ModelScore(
        **vars(gains),
        model=model.name,
        roi_psnr=average(views, "roi_psnr"),
        object_psnr=average(views, "object_psnr"),
        roi_ssim=average(views, "roi_ssim"),
        image_psnr=float(np.mean(list(image_views.values()))),
        gaussians=len(model.gaussians),
        gaussians_in_box=int(model.gaussians.in_box(plan.roi).sum()),
        seconds=float(model.seconds),
        stages={stage: float(seconds) for stage, seconds in model.stages.items()},
        ply_bytes=ply_bytes(model.gaussians),
        views=tuple(views),
        image_views=image_views,
        roi_flip=average(views, "roi_flip"),
        mask_psnr=average(views, "mask_psnr"),
        corrected_psnr=average(views, "corrected_psnr"),
        detail_psnr=average(views, "detail_psnr"),
        near_psnr=average(near, "roi_psnr"),
        far_psnr=average(far, "roi_psnr"),
        near_object_psnr=average(near, "object_psnr"),
        made_for=model.gaussians.target.name,
    )
