"""Training data of the benchmarks: all photos of a scene, in shuffled epochs."""

from __future__ import annotations

from collections.abc import Sequence

from roigs_engine.model.scene import PosedImage
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.training.photo_order import shuffled
from roigs_engine.training.stage_data import StageData


def all_photos(
    images: Sequence[PosedImage], extent: float, cache: PhotoCache | None = None
) -> StageData:
    """The data for a stage that trains on these photos.

    Args:
        images: all photos.
        extent: the scene's extent, world units.
        cache: cache for decoded photos; None: a new one.
    """
    return StageData(
        images=images,
        photos=cache or PhotoCache(images),
        photo_at=shuffled(range(len(images)), 0),
        extent=extent,
    )
