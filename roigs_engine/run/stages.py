"""Stages from a run's photos, boxes and settings."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence

from ..model.roi import OrientedBox
from ..model.scene import Int64, PosedImage
from ..training.budget import box_budgets
from ..training.config import TrainConfig
from ..training.photo_order import PhotoOrder
from ..training.view_spacing import view_spacing, with_spaced_rate
from ..training.view_spread import view_spread, with_spared_outside
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
    """A stage; its budgets, masks, SH learning rate and decay follow from its photos and boxes.

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
    if config.lr_shN_spacing:
        spacing = max(view_spacing(photos.seen(roi), roi) for roi in rois)
        config = with_spaced_rate(config, spacing)
    if config.outside_spared_spread:
        spread = max(view_spread(photos.seen(roi), roi) for roi in rois)
        config = with_spared_outside(config, spread)
    margins = tuple(roi.scaled(config.box_margin) for roi in rois)
    return Stage(
        name=name,
        images=images,
        config=config,
        start=start or points_source(run),
        order=(order or shuffled_order)(photos, images, config),
        rois=margins,
        budgets=box_budgets(images, margins, config, photos.context),
        seeing=() if config.full_every == 1 else photos.rows_seeing(images),
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


def points_source(run: Run, rows: Int64 | None = None) -> Source:
    """The sparse points, or these rows of them."""
    scene = run.train_scene
    chosen = slice(None) if rows is None else rows
    digest = hashlib.sha256(scene.points[chosen].tobytes() + scene.colors[chosen].tobytes())
    return Source(kind=POINTS, digest=digest.hexdigest(), rows=rows)


def path_of(folder: str, stage: str) -> str:
    """The name of a stage in a folder below the run folder; empty: in the run folder itself."""
    return f"{folder}/{stage}" if folder else stage
