"""Measures all models on one test photo."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..context import Context
from ..errors import ConfigError
from ..formats.text import counted
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import Camera, Float64, PosedImage
from ..photos.decode import load_photo
from ..photos.mask_images import load_mask, load_object_mask
from ..rasterize.view import render_view
from ..training.losses import clipped_like
from . import metrics
from .scores import FEW_VIEWS, MIN_OBJECT, MIN_SILHOUETTE, MeasuredView, ViewScore

PIXELS_AT_ONCE = 1 << 18  # pixels whose world positions are in memory at a time


@dataclass(frozen=True, kw_only=True, eq=False)
class EvaluatedModel:
    """A model to evaluate.

    Attributes:
        name: the row's name, unique among the rows of a box.
        seconds: total training time.
        rois: names of the boxes with a row for it; None for all. An Object-GS has one box.
        stages: stage -> seconds.
    """

    name: str
    gaussians: Gaussians
    seconds: float
    rois: tuple[str, ...] | None = None
    stages: dict[str, float] = field(default_factory=dict)

    def to(self, device: torch.device) -> EvaluatedModel:
        """Return the model on a device, which then renders it."""
        return dataclasses.replace(self, gaussians=self.gaussians.to(device))


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxPlan:
    """Plan of the measurements for one box.

    Attributes:
        views: the test views that count, by photo name.
        left_out: names of the other test views.
        models: the models with a row.
        mask_from: position of the model that defines the object's mask; None for the best one.
    """

    roi: OrientedBox
    views: dict[str, MeasuredView]
    left_out: tuple[str, ...]
    models: tuple[EvaluatedModel, ...]
    mask_from: int | None

    def only(self, names: Collection[str]) -> BoxPlan:
        """Return the plan with only these test views."""
        return dataclasses.replace(
            self,
            views={name: view for name, view in self.views.items() if name in names},
            left_out=tuple(name for name in self.left_out if name in names),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """Measurements of one view of one box, for the M models of `BoxPlan.models`.

    Attributes:
        scores: (M,) scores, without those in the object's mask.
        pixels: (M,) size of the object's mask from each model's depth.
        object_mse: (M, M) error of each model (row) in each model's mask (column); NaN if empty.
    """

    scores: list[ViewScore]
    pixels: list[int]
    object_mse: list[list[float]]


def points_in_box(
    depth: Tensor,  # (H, W)
    roi: OrientedBox,
    camera: Camera,
    world_to_camera: Float64,  # (4, 4)
    mask: Tensor,  # (H, W) bool
) -> Tensor:
    """(P,) bool for the mask's pixels, row by row: whether the point at their depth is in the box.

    False for a pixel without depth (0: no Gaussian).
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


def measured_pixels(roi: OrientedBox, image: PosedImage) -> NDArray[np.bool_]:
    """(H, W) the pixels of the box's silhouette that the photo's mask does not ignore."""
    silhouette, mask = roi.silhouette(image.camera, image.world_to_camera), load_mask(image)
    return silhouette if mask is None else silhouette & mask


def plan_views(
    roi: OrientedBox,
    images: Sequence[PosedImage],
    models: Sequence[EvaluatedModel],
    mask_from: str | None,
    context: Context,
    photos: str = "test",
) -> BoxPlan:
    """Decide which test views count for the box.

    ConfigError if two models of the box share a name, or none is named `mask_from`.
    """
    found = {}
    for image in images:
        context.check_cancelled()
        size = int(measured_pixels(roi, image).sum())
        found[image.name] = MeasuredView(
            view=image.name,
            silhouette_pixels=size,
            object_pixels=0,
            camera_inside=roi.camera_inside(image.world_to_camera),
            small=size < MIN_SILHOUETTE,
        )
    largest = max(view.silhouette_pixels for view in found.values())
    least = MIN_SILHOUETTE if largest >= MIN_SILHOUETTE else max(1, math.ceil(largest / 2))
    views = {name: view for name, view in found.items() if view.silhouette_pixels >= least}
    if not views:
        context.warn(f"No {photos} photo shows box '{roi.name}': no scores.")
    elif len(views) < FEW_VIEWS or largest < MIN_SILHOUETTE:
        large = sum(not view.small for view in views.values())
        hint = "Use a larger --max-side, or more" if large < len(images) else "Use more"
        count = counted(len(images), f"{photos} photo")
        context.warn(
            f"The scores of box '{roi.name}' are uncertain: {large} of {count} show it on "
            f"{MIN_SILHOUETTE:,} pixels or more. {hint} {photos} photos (a smaller "
            "--test-every)."
        )
    rows = tuple(m for m in models if m.rois is None or roi.name in m.rois)
    names = [model.name for model in rows]
    if len(set(names)) < len(names):
        raise ConfigError(
            f"Two models of box '{roi.name}' share a name ({', '.join(names)}).",
            "Give each model its own name.",
        )
    if mask_from is not None and mask_from not in names:
        raise ConfigError(
            f"Box '{roi.name}' has no model '{mask_from}' for the object's mask.",
            f"Its models are: {', '.join(names)}.",
        )
    return BoxPlan(
        roi=roi,
        views=views,
        left_out=tuple(name for name in found if name not in views),
        models=rows,
        mask_from=None if mask_from is None else names.index(mask_from),
    )


def measure_view(
    models: Sequence[EvaluatedModel], image: PosedImage, plans: Sequence[BoxPlan], context: Context
) -> tuple[dict[EvaluatedModel, float], list[Sample | None]]:
    """Measure all models on one photo; return PSNR of the whole image by model, and samples.

    There is one sample per plan, None if the photo does not count for its box.
    """
    device = models[0].gaussians.means.device
    photo, mask = torch.as_tensor(load_photo(image), device=device), load_mask(image)
    target = photo.float() / 255
    counted = None if mask is None else torch.as_tensor(mask, device=device)
    boxes = {
        index: _Box(plan, image, device)
        for index, plan in enumerate(plans)
        if image.name in plan.views
    }
    whole: dict[EvaluatedModel, float] = {}
    for model in models:
        context.check_cancelled()
        wanted = [box for box in boxes.values() if model in box.plan.models]
        view = render_view(
            model.gaussians, image.camera, image.world_to_camera, with_depth=bool(wanted)
        )
        picture = clipped_like(view.image.to(device), image)
        error = metrics.squared_error(picture, target)
        whole[model] = metrics.psnr_from_mse(metrics.mean_in(error, counted))
        if counted is not None:  # FLIP also depends on a pixel's neighbours
            picture = torch.where(counted[..., None], picture, target)
        for box in wanted:
            assert view.depth is not None
            pixels, camera = box.mask, (image.camera, image.world_to_camera)
            box.errors.append(error[pixels])
            box.objects.append(points_in_box(view.depth.to(device), box.plan.roi, *camera, pixels))
            corrected = metrics.corrected_error(picture, target, pixels)
            score = ViewScore(
                view=image.name,
                roi_psnr=metrics.psnr_from_mse(metrics.mean_in(error[pixels])),
                roi_ssim=metrics.ssim(picture, photo, pixels, counted),
                roi_flip=metrics.flip(picture, target, pixels),
                distance=box.distance,
                mask_psnr=box.psnr_in(box.shown),
                corrected_psnr=metrics.psnr_from_mse(corrected),
                detail_psnr=metrics.psnr_from_mse(metrics.detail_error(picture, target, pixels)),
            )
            box.scores.append(score)
    return whole, [boxes[index].sample() if index in boxes else None for index in range(len(plans))]


class _Box:
    """Measurements of one box on one photo, model by model.

    Attributes:
        plan: of the box.
        distance: of the camera from the box's centre, in diagonals of the box.
        mask: (H, W) bool, its P `measured_pixels`.
        shown: (P,) bool, the pixels of the photo's mask of the object; none without a mask.
        errors, objects: for each model, (P,) squared errors, and (P,) bool, the object's mask.
        scores: of each model.
    """

    def __init__(self, plan: BoxPlan, image: PosedImage, device: torch.device) -> None:
        self.plan, roi = plan, plan.roi
        self.distance = float(np.linalg.norm(image.centre - roi.centre)) / roi.diagonal
        pixels, shown = measured_pixels(roi, image), load_object_mask(image, roi.name)
        shown = np.zeros_like(pixels) if shown is None else shown
        self.mask = torch.from_numpy(pixels).to(device)
        self.shown = torch.from_numpy(shown[pixels]).to(device)
        self.errors: list[Tensor] = []
        self.objects: list[Tensor] = []
        self.scores: list[ViewScore] = []

    def psnr_in(self, pixels: Tensor) -> float | None:
        """Return the last model's PSNR in a mask (P,); None for fewer than `MIN_OBJECT` pixels."""
        if int(pixels.sum()) < MIN_OBJECT:
            return None
        return metrics.psnr_from_mse(metrics.mean_in(self.errors[-1], pixels))

    def sample(self) -> Sample:
        return Sample(
            scores=self.scores,
            pixels=[int(inside.sum()) for inside in self.objects],
            object_mse=[
                [metrics.mean_in(error, inside) for inside in self.objects] for error in self.errors
            ],
        )
