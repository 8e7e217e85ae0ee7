"""Whether colours depend on the view, and the SH learning rate that follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from roigs_engine.context import QUIET, Context
from roigs_engine.errors import Stopped
from roigs_engine.formats.events import Event, Message
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.run.presets import preset
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.measured_sh_rate import (
    FULL_RATE,
    MeasuredShRate,
    predicted_share,
)
from roigs_engine.training.stage_data import StageData
from tests.poses import look_at

SIZE, COUNT = 300, 17
CAMERA = Camera(width=SIZE, height=SIZE, fx=200.0, fy=200.0, cx=150.0, cy=150.0)
GRID = np.stack(np.meshgrid(np.linspace(-1, 1, 12), np.linspace(-1, 1, 12)), axis=-1).reshape(-1, 2)
POINTS = np.column_stack([np.zeros(len(GRID)), GRID])
BOX = OrientedBox.between("thing", [-1, -2, -2], [1, 2, 2])
Pixels = NDArray[np.uint8]
Colour = Callable[[float], NDArray[np.float64]]
"""Angle of a photo -> brightness of each point in it."""


class Photos(list[Pixels]):
    """Photos in memory."""

    def prefetch(self, indices: object) -> None:
        """Nothing to do."""


def scene(colour: Colour, distance: float = 4.0) -> tuple[list[PosedImage], Photos]:
    """Photos on an arc before the points, 5 degrees apart, with a patch for each point."""
    images, photos = [], Photos()
    for k in range(COUNT):
        angle = np.radians(-40 + 5 * k)
        eye = distance * np.array([np.cos(angle), np.sin(angle), 0.1])
        pose = look_at(eye, np.zeros(3))
        images.append(
            PosedImage(
                name=f"{k}.jpg",
                path=Path(),
                camera=CAMERA,
                world_to_camera=pose,
                point_indices=np.arange(len(POINTS)),
            )
        )
        pixels = np.zeros((SIZE, SIZE, 3), dtype=np.uint8)
        local = POINTS @ pose[:3, :3].T + pose[:3, 3]
        places = np.floor(local[:, :2] / local[:, 2:] * 200 + 150).astype(int)
        for (x, y), value in zip(places, colour(angle), strict=True):
            pixels[y - 2 : y + 3, x - 2 : x + 3] = np.clip(value, 0, 255)
        photos.append(pixels)
    return images, photos


def shine(angle: float) -> NDArray[np.float64]:
    """Brightness that changes smoothly with the view, at each point in its own way."""
    phase = np.arange(len(POINTS), dtype=np.float64)
    return 120 + 40 * np.sin(2 * angle + phase)


def noise(seed: int = 0) -> Colour:
    """Brightness that is another in each photo."""
    random = np.random.default_rng(seed)
    return lambda _: random.normal(120, 20, len(POINTS))


def share(colour: Colour) -> float | None:
    """The share that photos of such points predict."""
    images, photos = scene(colour)
    return predicted_share(images, photos, POINTS, [BOX])


def test_a_change_with_the_view_is_predicted_by_the_neighbour() -> None:
    value = share(shine)
    assert value is not None and value > 0.9


def test_noise_is_not() -> None:
    value = share(noise())
    assert value is not None and abs(value) < 0.1


def test_of_a_mixture_it_is_the_share_of_the_view() -> None:
    random = noise()
    value = share(lambda angle: shine(angle) + random(angle) - 120)
    assert value is not None and 0.3 < value < 0.8  # variances of about 800 and 400


def test_without_any_change_and_with_few_points_nothing_is_known() -> None:
    assert share(lambda _: np.full(len(POINTS), 99.0)) is None
    images, photos = scene(shine)
    few = [replace(image, point_indices=np.arange(20)) for image in images]
    assert predicted_share(few, photos, POINTS, [BOX]) is None
    assert predicted_share(images[:4], Photos(photos[:4]), POINTS, [BOX]) is None
    assert predicted_share([], Photos(), np.zeros((0, 3)), []) is None


def test_points_in_the_boxes_decide_if_they_are_enough() -> None:
    left, random = POINTS[:, 1] < 0, noise()
    images, photos = scene(lambda angle: np.where(left, shine(angle), random(angle)))
    box = OrientedBox.between("left", [-1, -2, -2], [1, 0, 2])
    inside = predicted_share(images, photos, POINTS, [box])
    all_ = predicted_share(images, photos, POINTS, [])
    assert inside is not None and inside > 0.9 and all_ is not None and all_ < 0.8
    few = OrientedBox.between("few", [-1, -2, -2], [1, -0.9, 2])
    assert predicted_share(images, photos, POINTS, [few]) == all_


def test_photos_of_another_scale_are_not_compared() -> None:
    """Close-ups show other texture: each alone depends on the view, which their mixture hides."""
    near, near_photos = scene(shine, distance=2.2)
    far, far_photos = scene(lambda angle: 250 - shine(angle), distance=4.0)
    mixed = predicted_share([*near, *far], Photos([*near_photos, *far_photos]), POINTS, [BOX])
    assert mixed is not None and mixed > 0.9


def test_ignored_pixels_have_no_colour() -> None:
    images, photos = scene(shine)
    wild, masked = scene(noise())[1], Photos()
    for k, (good, bad) in enumerate(zip(photos, wild, strict=True)):
        counts = np.full((SIZE, SIZE, 1), 0 if k % 2 else 255, dtype=np.uint8)
        masked.append(np.dstack([bad if k % 2 else good, counts]))
    value = predicted_share(images, masked, POINTS, [BOX])
    assert value is not None and value > 0.8


def test_points_that_a_photo_cannot_show_are_left_out() -> None:
    images, photos = scene(shine)
    behind = np.array([[1e3, 0.0, 0.0], [4.0, 0.0, 0.4], [0.0, 0.0, 1e3]])
    images = [replace(image, point_indices=np.arange(len(POINTS) + 3)) for image in images]
    value = predicted_share(images, photos, np.concatenate([POINTS, behind]), [])
    assert value is not None and value > 0.9


def data(colour: Colour) -> StageData:
    """A stage on such photos."""
    images, photos = scene(colour)
    return StageData(
        images=images,
        photos=photos,
        photo_at=lambda step: step,
        extent=1.0,
        rois=[BOX],
        points=POINTS,
        device=torch.device("cpu"),
    )


def test_the_rate_follows() -> None:
    config = TrainConfig(steps=9, lr_shN=1.5e-3, mechanisms=(MeasuredShRate(),))
    assert config.measured(data(shine), QUIET) == config
    lowered = config.measured(data(noise()), QUIET)
    assert lowered.lr_shN == pytest.approx(TrainConfig.lr_shN, rel=0.6)
    assert replace(lowered, lr_shN=config.lr_shN) == config
    part = (share(noise()) or 0.0) / FULL_RATE
    assert lowered.lr_shN == pytest.approx(1.25e-4 * 12 ** max(part, 0.0))


def test_what_cannot_be_measured_is_not_assumed() -> None:
    """As with a dozen photos from all sides: none shows what is between them."""
    whole = data(shine)
    config = TrainConfig(steps=9, lr_shN=1.5e-3, mechanisms=(MeasuredShRate(),))
    few = replace(whole, images=whole.images[:4], photos=Photos(whole.photos[:4]))  # type: ignore[index, arg-type]
    said: list[Event] = []
    lowered = config.measured(few, Context(emit=said.append))
    assert lowered == replace(config, lr_shN=TrainConfig.lr_shN) and len(said) == 1
    bare = [replace(image, point_indices=np.zeros(0, dtype=np.int64)) for image in whole.images]
    assert config.measured(replace(whole, images=bare), QUIET) == config


def test_a_lower_rate_is_said() -> None:
    said: list[Event] = []
    config = TrainConfig(steps=9, lr_shN=1.5e-3, mechanisms=(MeasuredShRate(),))
    config.measured(data(noise()), Context(emit=said.append))
    (message,) = said
    assert isinstance(message, Message) and "SH learning rate" in message.text
    config.measured(data(shine), Context(emit=said.append))
    assert len(said) == 1


def test_it_is_not_measured_without_need() -> None:
    """Nor are photos read: the standard rate, and the preset of the paper."""
    unread = replace(data(shine), photos=PhotoCache([]))
    for config in (
        TrainConfig(steps=9, lr_shN=1.5e-3),
        TrainConfig(steps=9, mechanisms=(MeasuredShRate(),)),
        preset("paper").roi,
        preset("draft").scene,
    ):
        assert config.measured(unread, QUIET) == config
    for name in ("draft", "standard"):
        assert preset(name).roi.get(MeasuredShRate) is not None


def test_it_stops_on_request() -> None:
    config = TrainConfig(steps=9, lr_shN=1.5e-3, mechanisms=(MeasuredShRate(),))
    with pytest.raises(Stopped):
        config.measured(data(shine), Context(should_stop=lambda: True))
