"""Makes a run's stages: for the whole scene, or one for each cell."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence, Set
from copy import copy
from dataclasses import replace

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats import run_files
from ..model.ownership import Partition
from ..model.roi import OrientedBox
from ..model.scene import Int64, PosedImage
from ..model.visibility import visible_images
from ..selection import CameraSelection, select_cameras
from ..selection.manual import manual_selection
from ..selection.split import interleaved, reserved
from ..training.config import PlannedViews, TrainConfig
from ..training.mechanisms.cutout_steps import CutoutSteps
from ..training.mechanisms.masked_steps import MaskedSteps
from ..training.mechanisms.surface_losses import SurfaceLosses
from ..training.photo_order import PhotoOrder
from . import stage_configs
from .definition import Run
from .layout import Cell
from .plan import CELLS, POINTS, SEEN, PlannedModel, Source, Stage


class PhotoSets:
    """The training photos and boxes of a run or a cell; their subsets are cached.

    Attributes:
        folder: for their stages, below the run folder; empty: the run folder itself.
        images: in the scene's order.
        rois: the boxes.
    """

    def __init__(self, run: Run, context: Context = QUIET, *, folder: str = "") -> None:
        self.run, self.context, self.folder = run, context, folder
        self.images, self.rois = run.train_scene.images, run.rois
        self._selections: dict[str, CameraSelection] = {}
        self._seen: dict[str, Set[str]] = {}

    def of(self, cell: Cell) -> PhotoSets:
        """The photos and boxes of a cell."""
        part, names = copy(self), set(cell.photos)
        part.images = tuple(image for image in self.images if image.name in names)
        part.rois = cell.rois
        return part

    def selection(self, roi: OrientedBox) -> CameraSelection:
        """The box's photos, best first: the manual selection, or the method's."""
        if roi.name not in self._selections:
            run, context = self.run, self.context
            self._selections[roi.name] = (
                manual_selection(run.train_scene, roi, run.manual[roi.name], context)
                if roi.name in run.manual
                else select_cameras(
                    run.train_scene, roi, run.config.selection, context, tests=run.test_scene
                )
            )
        return self._selections[roi.name]

    def selections(self) -> tuple[CameraSelection, ...]:
        """The selections of the boxes, in their order."""
        return tuple(self.selection(roi) for roi in self.rois)

    def selected(self) -> set[str]:
        """Names of the photos selected for any of the boxes."""
        return set(interleaved([chosen.names for chosen in self.selections()]))

    def reserved(self) -> set[str]:
        """Names of the selected photos that the Scene-GS must not use (paper, sec. II-B)."""
        orders = [chosen.names for chosen in self.selections()]
        return reserved(orders, self.run.config.kept_share)

    def seen(self, roi: OrientedBox) -> tuple[PosedImage, ...]:
        """The training photos that see the box."""
        if roi.name not in self._seen:
            known = self.run.layout.seen.get(roi.name)
            scene = self.run.train_scene
            self._seen[roi.name] = known or set(visible_images(scene, roi, self.context))
        names = self._seen[roi.name]
        return tuple(image for image in self.images if image.name in names)


def make_stage(
    name: str,
    photos: PhotoSets,
    images: tuple[PosedImage, ...],
    config: TrainConfig,
    *,
    rois: Sequence[OrientedBox] = (),
    start: Source | None = None,
    order: str = "shuffled",
) -> Stage:
    """Make a stage; its mechanisms adapt their settings to its photos and boxes.

    Args:
        name, config: of the stage; the folder of `photos` precedes the name.
        photos: of the run, or of a part of it.
        images: to train on.
        rois: boxes to densify in.
        start: the Gaussians to start from; None: the sparse points.
        order: `shuffled`: all photos equally often; `ordered`: as given (paper, sec. III-A);
            `mixed`: selected photos more often than others.
    """
    run = photos.run
    views = PlannedViews(images=images, rois=rois, seen=photos.seen, context=photos.context)
    config = config.planned(views)
    return Stage(
        name=f"{photos.folder}/{name}" if photos.folder else name,
        images=images,
        config=config,
        start=start or points_source(run),
        order=_order(order, photos, images, config),
        rois=tuple(rois),
        extent=run.extent,
        seed=run.config.seed,
    )


def _order(
    kind: str, photos: PhotoSets, images: Sequence[PosedImage], config: TrainConfig
) -> PhotoOrder:
    """The order of a stage's photos: see `make_stage`."""
    order = PhotoOrder(kind=kind, count=len(images), seed=photos.run.config.seed)
    if kind != "mixed":
        return order
    selected, masks = photos.selected(), config.get(MaskedSteps)
    return replace(
        order,
        selected=tuple(row for row, image in enumerate(images) if image.name in selected),
        drawn=masks.seeing if masks else tuple(range(len(images))),
        share=photos.run.config.selected_share,
        whole_share=masks.whole_share if masks else 0.0,
    )


def points_source(run: Run, rows: Int64 | None = None) -> Source:
    """The sparse points, or these rows of them, as a source."""
    scene = run.train_scene
    chosen = slice(None) if rows is None else rows
    digest = hashlib.sha256(scene.points[chosen].tobytes() + scene.colors[chosen].tobytes())
    return Source(kind=POINTS, digest=digest.hexdigest(), rows=rows)


def trained_on(
    name: str, photos: PhotoSets, config: TrainConfig, base: Source | None
) -> PlannedModel:
    """Plan the training of a model in all boxes, cell by cell if the run has cells.

    Args:
        name: of the stage; it follows the cell's label, if there is one.
        photos: of the run.
        config: of the stage for the whole scene.
        base: the model to continue; None: the sparse points.
    """
    cells = photos.run.layout.cells
    if cells is None:
        images, rois = photos.images, photos.rois
        stage = make_stage(name, photos, images, config, rois=rois, start=base, order="mixed")
        return PlannedModel.of_stages(name, stage)
    alone = bool(config.chosen(CutoutSteps, SurfaceLosses))
    stages = []
    for index, cell in enumerate(cells.cells):
        if alone and base is not None and not cell.rois:  # without objects, it does not change
            stages.append(base.inputs[index])
            continue
        own = photos.of(cell)
        stage = make_stage(
            f"{cell.label}-{name}",
            own,
            own.images,
            _config(photos, config, cell),
            rois=cell.rois,
            start=_start(photos.run, base, cell, own.images),
            order="mixed" if cell.rois else "shuffled",
        )
        stages.append(stage)
    return joined(name, stages, cells.partition)


def _config(photos: PhotoSets, config: TrainConfig, cell: Cell) -> TrainConfig:
    """The settings of a cell's stage: a group gets all steps, a block its share of them."""
    if photos.run.layout.blocks is None:
        return config
    share = len(cell.photos) / len(photos.images)
    if cell.rois:
        return stage_configs.block_stage(config, cell.share, share)
    return stage_configs.surroundings_stage(config, share)


def _start(
    run: Run, base: Source | None, cell: Cell, images: Sequence[PosedImage]
) -> Source | None:
    """The start of a cell's stage; in a scene of blocks, only Gaussians that its photos show."""
    if run.layout.blocks is None:
        return base
    if base is None:
        return points_source(run, cell.points)
    return seen_part(run, base, images, len(cell.points) / len(run.train_scene.points))


def seen_part(run: Run, base: Source, images: Sequence[PosedImage], share: float = 1.0) -> Source:
    """The start of a stage on some photos; in a scene of blocks, the Gaussians that they show."""
    if run.layout.blocks is None:
        return base
    return Source(kind=SEEN, base=base, images=tuple(images), share=share)


def joined(name: str, stages: Sequence[Stage], partition: Partition) -> PlannedModel:
    """Join the stages' results: from each, the Gaussians that it owns in the partition."""
    inputs = tuple(stages)
    source = Source(kind=CELLS, inputs=inputs, digest=partition.digest, partition=partition)
    return PlannedModel(name=name, source=source, stages=inputs)


def scene_model(photos: PhotoSets) -> PlannedModel:
    """The Scene-GS: one stage, or one for each block."""
    run, name = photos.run, "Scene-GS"
    blocks = run.layout.blocks
    if blocks is None:
        return PlannedModel.of_stages(name, scene_stage(photos))
    stages = [
        make_stage(
            f"{cell.label}-{run_files.SCENE_STAGE}",
            photos,
            _images(photos, photos.of(cell).images),
            stage_configs.surroundings_stage(run.config.scene, cell.share),
            start=points_source(run, cell.points),
        )
        for cell in blocks.cells
    ]
    return joined(name, stages, blocks.partition)


def scene_stage(photos: PhotoSets) -> Stage:
    """The Scene-GS of a scene without blocks."""
    images = _images(photos, photos.images)
    return make_stage(run_files.SCENE_STAGE, photos, images, photos.run.config.scene)


def _images(photos: PhotoSets, images: Sequence[PosedImage]) -> tuple[PosedImage, ...]:
    """These photos without the reserved ones, at the Scene-GS's size."""
    reserved = photos.reserved()
    kept = tuple(image for image in images if image.name not in reserved)
    if not kept:
        raise SceneError(
            "All photos are reserved for boxes: none is left to train the scene on.",
            "Raise --kept-share (1 keeps all), or select fewer photos (--count).",
        )
    return tuple(image.scaled(photos.run.config.scene_scale) for image in kept)
