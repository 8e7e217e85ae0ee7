"""The Scene-GS (paper, sec. II-B): all photos except those reserved for the boxes."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import SceneError
from ..formats import run_files
from ..model.scene import PosedImage
from . import stage_configs
from .cell_stages import joined
from .photo_sets import PhotoSets
from .plan import PlannedModel, Stage
from .stages import make_stage, path_of, points_source


def scene_model(photos: PhotoSets, folder: str = "") -> PlannedModel:
    """The Scene-GS: of one stage, or of one for each block of a scene that is cut."""
    run, name = photos.run, "Scene-GS"
    blocks = run.layout.blocks
    if blocks is None:
        return PlannedModel.of_stages(name, scene_stage(photos, folder))
    stages = [
        make_stage(
            path_of(folder, f"{cell.label}-{run_files.SCENE_STAGE}"),
            photos,
            _images(photos, photos.of(cell).images),
            stage_configs.surroundings_stage(run.config.scene, cell.share),
            start=points_source(run, cell.points),
        )
        for cell in blocks.cells
    ]
    return joined(name, stages, blocks.partition)


def scene_stage(photos: PhotoSets, folder: str = "") -> Stage:
    """The Scene-GS of a scene that is not cut."""
    name = path_of(folder, run_files.SCENE_STAGE)
    return make_stage(name, photos, _images(photos, photos.images), photos.run.config.scene)


def _images(photos: PhotoSets, images: Sequence[PosedImage]) -> tuple[PosedImage, ...]:
    """These photos without the reserved ones, at the size of the Scene-GS."""
    reserved = photos.reserved()
    kept = tuple(image for image in images if image.name not in reserved)
    if not kept:
        raise SceneError(
            "All photos are reserved for boxes: none is left to train the scene on.",
            "Raise --kept-share (1 keeps all), or select fewer photos (--count).",
        )
    return tuple(image.scaled(photos.run.config.scene_scale) for image in kept)
