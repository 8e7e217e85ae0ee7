"""Held-out photos against renders: the paper's table for every box, and what it leaves out.

Masks (docs/method.md, evaluation): the silhouette of the box, which is the paper's mask, and the
object's pixels, those of the silhouette whose expected depth lies inside the box in the model that
scores best on the silhouette, or in a named one; the same pixels for every row of a box. PSNR is
computed per view and then averaged. Renders are compared as they are, clamped to [0, 1] but not
rounded to 8 bits.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from . import metrics
from .errors import ConfigError, SceneError
from .events import Check, Emit, Message, StageStarted, go_on, ignore, step_done
from .gaussians import Gaussians
from .images import load_photo
from .render import render_view
from .roi import OrientedBox
from .scene import Camera, Float64, PosedImage, SfmScene
from .scores import (
    MIN_OBJECT,
    MIN_SILHOUETTE,
    Evaluation,
    MeasuredView,
    ModelScore,
    RoiScores,
    ViewScore,
)

PIXELS_AT_ONCE = 1 << 18  # whose points in the world are held

__all__ = ["EvaluatedModel", "Evaluation", "evaluate"]


@dataclass(frozen=True, kw_only=True, eq=False)
class EvaluatedModel:
    """A model to be measured.

    Attributes:
        name: the row's name, unique among the rows of a box.
        gaussians: the model.
        seconds: what its training took, in all.
        rois: names of the boxes it gets a row for; None means all (an Object-GS has one).
        stages: seconds by stage.
    """

    name: str
    gaussians: Gaussians
    seconds: float
    rois: tuple[str, ...] | None = None
    stages: dict[str, float] = field(default_factory=dict)

    def to(self, device: torch.device) -> EvaluatedModel:
        """The same with its Gaussians on a device, where they are then drawn."""
        return dataclasses.replace(self, gaussians=self.gaussians.to(device))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Plan:
    """What is measured for one box: its views by photo name, and the models that have a row.

    `mask_from` is the model that makes the object's mask; None: the best one.
    """

    roi: OrientedBox
    views: dict[str, MeasuredView]
    left_out: tuple[str, ...]
    models: tuple[EvaluatedModel, ...]
    mask_from: int | None


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sample:
    """One view of one box. Depth sources and models are indexed alike, as in `_Plan.models`.

    Attributes:
        psnr, ssim: (M,) inside the silhouette.
        pixels: (M,) size of the object's mask by the depth of each model.
        object_mse: (M, M) [model, depth source] inside that mask; NaN where it is empty.
    """

    psnr: list[float]
    ssim: list[float]
    pixels: list[int]
    object_mse: list[list[float]]


def evaluate(
    models: Sequence[EvaluatedModel],
    scene: SfmScene,
    test: Sequence[str],
    rois: Sequence[OrientedBox],
    *,
    emit: Emit = ignore,
    check: Check = go_on,
    baseline: str = "Full Scene",
    object_mask_from: str | None = None,
) -> Evaluation:
    """Measure every model on the held-out photos `test` of `scene` (which holds all photos).

    Each test view is rendered once per model and dropped again. The object's mask needs the best
    model, which is known only at the end: so each view's errors are summed inside the mask of
    every model's depth, a handful of numbers, and the best model's are picked afterwards.

    Args:
        models, scene, test, rois: see above.
        emit, check: as everywhere.
        baseline: name of the model that gains are counted from.
        object_mask_from: name of the model whose depth makes the object's mask; None: the best one.
            Evaluations that are to be compared need the same.

    Raises:
        SceneError: no test view, or one that the scene does not have.
        ConfigError: no model, two of one name for one box, or no `object_mask_from` for one.
    """
    images = _checked(models, scene, test)
    plans = [_plan(roi, images, models, object_mask_from, emit, check) for roi in rois]
    samples: list[dict[str, _Sample]] = [{} for _ in plans]
    image_views: dict[EvaluatedModel, dict[str, float]] = {model: {} for model in models}
    emit(StageStarted(stage="evaluate", total=len(images)))
    started = time.monotonic()
    for step, image in enumerate(images, start=1):
        whole, measured = _measure_view(models, image, plans, check)
        for model, value in whole.items():
            image_views[model][image.name] = value
        for store, sample in zip(samples, measured, strict=True):
            if sample is not None:
                store[image.name] = sample
        emit(
            step_done(
                "evaluate",
                step,
                len(images),
                started,
                psnr=max(whole.values()),
                gaussians=max(len(model.gaussians) for model in models),
            )
        )
    tables = [_table(p, s, image_views, baseline) for p, s in zip(plans, samples, strict=True)]
    names = tuple(image.name for image in images)
    return Evaluation(test_views=names, baseline=baseline, rois=tuple(tables))


def ply_bytes(gaussians: Gaussians) -> int:
    """Size of the model's PLY without its header: 14 + 3 K float32 numbers a Gaussian."""
    return 4 * len(gaussians) * (14 + 3 * gaussians.sh.shape[1])


def points_in_box(
    depth: Tensor,  # (H, W)
    roi: OrientedBox,
    camera: Camera,
    world_to_camera: Float64,  # (4, 4)
    mask: Tensor,  # (H, W) bool
) -> Tensor:
    """(P,) for the mask's pixels, row by row: whether the point at that depth is in the box.

    A pixel without depth (0: nothing rendered there) is not.
    """
    rows, columns = (index.cpu().numpy() for index in torch.nonzero(mask, as_tuple=True))
    z = depth[mask].cpu().numpy()
    inside = np.zeros(len(z), dtype=bool)
    for part in (slice(k, k + PIXELS_AT_ONCE) for k in range(0, len(z), PIXELS_AT_ONCE)):
        deep = z[part].astype(np.float64)
        x = (columns[part] + 0.5 - camera.cx) / camera.fx * deep
        y = (rows[part] + 0.5 - camera.cy) / camera.fy * deep
        points = np.stack([x, y, deep], axis=1) - world_to_camera[:3, 3]
        inside[part] = roi.contains(points @ world_to_camera[:3, :3]) & (deep > 0)
    return torch.from_numpy(inside).to(mask.device)


def _checked(
    models: Sequence[EvaluatedModel], scene: SfmScene, test: Sequence[str]
) -> list[PosedImage]:
    """The test photos in the scene's order."""
    if not models:
        raise ConfigError("There is no model to evaluate.")
    unknown = set(test) - {image.name for image in scene.images}
    if unknown:
        raise SceneError(f"Test photo «{min(unknown)}» is not in the scene.")
    if not test:
        raise SceneError("No photo is held out for testing.", "Set test_every.")
    return list(scene.select(set(test)).images)


def _plan(
    roi: OrientedBox,
    images: Sequence[PosedImage],
    models: Sequence[EvaluatedModel],
    mask_from: str | None,
    emit: Emit,
    check: Check,
) -> _Plan:
    """Which of the test views count for the box."""
    sizes = {}
    for image in images:
        check()
        sizes[image.name] = int(roi.silhouette(image.camera, image.world_to_camera).sum())
    inside = {i.name: roi.camera_inside(i.world_to_camera) for i in images}
    largest = max(sizes.values())
    least = MIN_SILHOUETTE if largest >= MIN_SILHOUETTE else max(1, math.ceil(largest / 2))
    views = {
        name: MeasuredView(
            view=name,
            silhouette_pixels=size,
            object_pixels=0,
            camera_inside=inside[name],
            small=size < MIN_SILHOUETTE,
        )
        for name, size in sizes.items()
        if size >= least
    }
    if not views:
        emit(Message(text=f"No test photo shows ROI «{roi.name}»: no scores.", level="warning"))
    rows = tuple(m for m in models if m.rois is None or roi.name in m.rois)
    names = [model.name for model in rows]
    if len(set(names)) < len(names):
        raise ConfigError(f"Two models of ROI «{roi.name}» share a name ({', '.join(names)}).")
    if mask_from is not None and mask_from not in names:
        raise ConfigError(
            f"No model of ROI «{roi.name}» is named «{mask_from}», which the object's mask needs.",
            f"There are: {', '.join(names)}.",
        )
    return _Plan(
        roi=roi,
        views=views,
        left_out=tuple(name for name in sizes if name not in views),
        models=rows,
        mask_from=None if mask_from is None else names.index(mask_from),
    )


def _measure_view(
    models: Sequence[EvaluatedModel], image: PosedImage, plans: Sequence[_Plan], check: Check
) -> tuple[dict[EvaluatedModel, float], list[_Sample | None]]:
    """Every model on one photo: whole-image PSNR by model, one sample for each box that counts."""
    device = models[0].gaussians.means.device
    photo = torch.as_tensor(load_photo(image), device=device)
    target = photo.float() / 255
    masks = {
        index: torch.from_numpy(plan.roi.silhouette(image.camera, image.world_to_camera)).to(device)
        for index, plan in enumerate(plans)
        if image.name in plan.views
    }
    whole: dict[EvaluatedModel, float] = {}
    ssim: dict[int, list[float]] = {index: [] for index in masks}
    errors: dict[int, list[Tensor]] = {index: [] for index in masks}
    objects: dict[int, list[Tensor]] = {index: [] for index in masks}
    for model in models:
        check()
        wanted = [index for index in masks if model in plans[index].models]
        view = render_view(
            model.gaussians, image.camera, image.world_to_camera, with_depth=bool(wanted)
        )
        picture = view.image.to(device)
        error = metrics.squared_error(picture, target)
        whole[model] = metrics.psnr_from_mse(metrics.mean_in(error))
        for index in wanted:
            mask, roi = masks[index], plans[index].roi
            assert view.depth is not None
            depth = view.depth.to(device)
            errors[index].append(error[mask])
            ssim[index].append(metrics.ssim(picture, photo, mask))
            inside = points_in_box(depth, roi, image.camera, image.world_to_camera, mask)
            objects[index].append(inside)
    return whole, [
        _sample(errors[index], ssim[index], objects[index]) if index in masks else None
        for index in range(len(plans))
    ]


def _sample(errors: list[Tensor], ssim: list[float], objects: list[Tensor]) -> _Sample:
    """Sums over the silhouette's P pixels: errors (P,) float and objects (P,) bool per model."""
    return _Sample(
        psnr=[metrics.psnr_from_mse(metrics.mean_in(error)) for error in errors],
        ssim=ssim,
        pixels=[int(inside.sum()) for inside in objects],
        object_mse=[[metrics.mean_in(error, inside) for inside in objects] for error in errors],
    )


def _table(
    plan: _Plan,
    samples: dict[str, _Sample],
    image_views: dict[EvaluatedModel, dict[str, float]],
    baseline: str,
) -> RoiScores:
    """One box's rows, once all views are measured."""
    names = [model.name for model in plan.models]
    means = [_mean([sample.psnr[k] for sample in samples.values()]) for k in range(len(names))]
    scored = [k for k, mean in enumerate(means) if mean is not None]
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
    plan: _Plan,
    index: int,
    samples: dict[str, _Sample],
    best: int | None,
    base: int | None,
    image_views: dict[str, float],
) -> ModelScore:
    """The row of model `index`; `best` made the object's mask, gains are over model `base`."""
    model = plan.models[index]
    views = []
    for name, sample in samples.items():
        psnr = None
        if best is not None and sample.pixels[best] >= MIN_OBJECT:
            psnr = metrics.psnr_from_mse(sample.object_mse[index][best])
        views.append(
            ViewScore(
                view=name,
                roi_psnr=sample.psnr[index],
                roi_ssim=sample.ssim[index],
                object_psnr=psnr,
            )
        )
    gains: dict[str, float] = {}
    if base is not None and base != index:
        gains = {name: s.psnr[index] - s.psnr[base] for name, s in samples.items()}
    peak_view = max(gains, key=lambda name: gains[name]) if gains else None
    return ModelScore(
        model=model.name,
        roi_psnr=_mean([view.roi_psnr for view in views]),
        object_psnr=_mean([v.object_psnr for v in views if v.object_psnr is not None]),
        roi_ssim=_mean([view.roi_ssim for view in views]),
        image_psnr=float(np.mean(list(image_views.values()))),
        peak_gain=None if peak_view is None else gains[peak_view],
        peak_view=peak_view,
        gaussians=len(model.gaussians),
        gaussians_in_box=int(model.gaussians.in_box(plan.roi).sum()),
        seconds=float(model.seconds),
        stages={stage: float(seconds) for stage, seconds in model.stages.items()},
        ply_bytes=ply_bytes(model.gaussians),
        views=tuple(views),
        image_views=image_views,
    )


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
