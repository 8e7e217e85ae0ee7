"""Stages that go on with a model: one for the whole scene, or one for each cell of a run."""

from __future__ import annotations

from collections.abc import Sequence

from ..model.ownership import Partition
from ..model.scene import PosedImage
from ..training.config import TrainConfig
from ..training.mechanisms.cutout_steps import CutoutSteps
from . import stage_configs
from .definition import Run
from .layout import Cell
from .photo_sets import PhotoSets
from .plan import CELLS, SEEN, PlannedModel, Source, Stage
from .stages import make_stage, mixed_order, path_of, points_source


def trained_on(
    name: str,
    photos: PhotoSets,
    config: TrainConfig,
    base: Source | None,
    *,
    folder: str = "",
) -> PlannedModel:
    """A model that is trained on in all boxes, cell by cell if the run has cells.

    Args:
        name: of the stage; after the cell's label, if there is one.
        photos: of the run.
        config: of the stage for the whole scene.
        base: what it goes on with; None: the sparse points.
        folder: of the stages, below the run folder.
    """
    cells = photos.run.layout.cells
    if cells is None:
        stage = make_stage(
            path_of(folder, name),
            photos,
            photos.images,
            config,
            rois=photos.rois,
            start=base,
            order=mixed_order,
        )
        return PlannedModel.of_stages(name, stage)
    alone = config.get(CutoutSteps) is not None
    stages = []
    for index, cell in enumerate(cells.cells):
        if alone and base is not None and not cell.rois:  # no object: it stays as it is
            stages.append(base.inputs[index])
            continue
        own = photos.of(cell)
        stage = make_stage(
            path_of(folder, f"{cell.label}-{name}"),
            own,
            own.images,
            _config(photos, config, cell),
            rois=cell.rois,
            start=_start(photos.run, base, cell, own.images),
            order=mixed_order if cell.rois else None,
        )
        stages.append(stage)
    return joined(name, stages, cells.partition)


def _config(photos: PhotoSets, config: TrainConfig, cell: Cell) -> TrainConfig:
    """Of a cell's stage: a group has all steps, a block its share of them."""
    if photos.run.layout.blocks is None:
        return config
    share = len(cell.photos) / len(photos.images)
    if cell.rois:
        return stage_configs.block_stage(config, cell.share, share)
    return stage_configs.surroundings_stage(config, share)


def _start(
    run: Run, base: Source | None, cell: Cell, images: Sequence[PosedImage]
) -> Source | None:
    """What a cell's stage starts from: in a scene that is cut, only what its photos show."""
    if run.layout.blocks is None:
        return base
    if base is None:
        return points_source(run, cell.points)
    return seen_part(run, base, images, len(cell.points) / len(run.train_scene.points))


def seen_part(run: Run, base: Source, images: Sequence[PosedImage], share: float = 1.0) -> Source:
    """The Gaussians that a stage on some photos starts from: in a scene that is cut, a part."""
    if run.layout.blocks is None:
        return base
    return Source(kind=SEEN, base=base, images=tuple(images), share=share)


def joined(name: str, stages: Sequence[Stage], partition: Partition) -> PlannedModel:
    """A model of what each stage's model owns of its result."""
    inputs = tuple(stages)
    source = Source(kind=CELLS, inputs=inputs, digest=partition.digest, partition=partition)
    return PlannedModel(name=name, source=source, stages=inputs)
