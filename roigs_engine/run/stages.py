"""Stages from a run's photos, boxes and settings."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence

from ..model.roi import OrientedBox
from ..model.scene import Int64, PosedImage
from ..training.config import PlannedViews, TrainConfig
from ..training.mechanisms.masked_steps import MaskedSteps
from ..training.photo_order import PhotoOrder
from .definition import Run
from .photo_sets import PhotoSets
from .plan import POINTS, Source, Stage

Order = Callable[[PhotoSets, Sequence[PosedImage], TrainConfig], PhotoOrder]


def make_stage(
    name: str,
    photos: PhotoSets,
    images: tuple[PosedImage, ...],
    config: TrainConfig,
    *,
    rois: Sequence[OrientedBox] = (),
    start: Source | None = None,
    order: Order | None = None,
) -> Stage:
    """A stage, with what its mechanisms decide by its photos and boxes.

    Args:
        name: its folder below the run folder.
        photos: of the run, or of a part of it.
        images: to train on.
        config: settings.
        rois: boxes to densify in; without, the spacing of views is that around all boxes.
        start: what it starts from; None: the sparse points.
        order: of its photos; None: `shuffled_order`.
    """
    run = photos.run
    views = PlannedViews(images=images, rois=rois, seen=photos.seen, context=photos.context)
    config = config.planned(views)
    return Stage(
        name=name,
        images=images,
        config=config,
        start=start or points_source(run),
        order=(order or shuffled_order)(photos, images, config),
        rois=tuple(rois),
        extent=run.extent,
        seed=run.config.seed,
    )


def shuffled_order(
    photos: PhotoSets, images: Sequence[PosedImage], config: TrainConfig
) -> PhotoOrder:
    """All photos equally often, in random order."""
    return PhotoOrder(kind="shuffled", count=len(images), seed=photos.run.config.seed)


def in_order(photos: PhotoSets, images: Sequence[PosedImage], config: TrainConfig) -> PhotoOrder:
    """The photos in the order given (paper, sec. III-A)."""
    return PhotoOrder(kind="ordered", count=len(images))


def mixed_order(photos: PhotoSets, images: Sequence[PosedImage], config: TrainConfig) -> PhotoOrder:
    """Selected photos more often than others."""
    selected, masks = photos.selected(), config.get(MaskedSteps)
    return PhotoOrder(
        kind="mixed",
        count=len(images),
        seed=photos.run.config.seed,
        selected=tuple(row for row, image in enumerate(images) if image.name in selected),
        drawn=masks.seeing if masks else tuple(range(len(images))),
        share=photos.run.config.selected_share,
        full_every=masks.full_every if masks else 1,
    )


def points_source(run: Run, rows: Int64 | None = None) -> Source:
    """The sparse points, or these rows of them."""
    scene = run.train_scene
    chosen = slice(None) if rows is None else rows
    digest = hashlib.sha256(scene.points[chosen].tobytes() + scene.colors[chosen].tobytes())
    return Source(kind=POINTS, digest=digest.hexdigest(), rows=rows)


def path_of(folder: str, stage: str) -> str:
    """The name of a stage in a folder below the run folder; empty: in the run folder itself."""
    return f"{folder}/{stage}" if folder else stage
