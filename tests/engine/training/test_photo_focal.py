"""The focal length of a stage's photos, which its model remembers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.training.stage_data import StageData


def photo(focal: float, side: int = 64) -> PosedImage:
    camera = Camera(width=side, height=side, fx=focal, fy=focal, cx=side / 2, cy=side / 2)
    return PosedImage(name="a.jpg", path=Path(), camera=camera, world_to_camera=np.eye(4))


def data(*images: PosedImage) -> StageData:
    return StageData(images=images, photos=[], photo_at=lambda step: 0, extent=1.0)


def test_photos_of_one_lens_have_one() -> None:
    assert data(photo(100.0), photo(100.0)).photo_focal == 100.0
    assert data(photo(100.0), photo(102.0), photo(104.0)).photo_focal == 102.0


def test_small_photos_have_that_of_the_whole_ones() -> None:
    for side in (64, 63, 427):
        small = data(photo(123.456789, side).scaled(0.5)).photo_focal
        assert small == data(photo(123.456789, side)).photo_focal == 123.457


def test_photos_of_several_lenses_have_none_in_common() -> None:
    assert data(photo(100.0), photo(150.0)).photo_focal is None
    assert data().photo_focal is None
