"""Angular spacing of photos around a box, and the resulting SH rate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.run.presets import preset
from roigs_engine.training.config import PlannedViews, TrainConfig
from roigs_engine.training.mechanisms.spaced_sh_rate import SpacedShRate, view_spacing
from tests.poses import look_at

BOX = OrientedBox.between("thing", [1, 1, 1], [3, 3, 3])


def ring(degrees: float, count: int, radius: float = 5.0) -> list[PosedImage]:
    """Photos on an arc around the box's centre, so far apart, which look at it."""
    images, at_centre = [], np.eye(4)
    at_centre[:3, 3] = -BOX.centre
    for k in range(count):
        angle = np.radians(k * degrees)
        eye = BOX.centre + radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        images.append(
            PosedImage(
                name=f"{k}.jpg",
                path=Path(),
                camera=Camera(width=200, height=200, fx=200.0, fy=200.0, cx=100.0, cy=100.0),
                world_to_camera=look_at(eye, BOX.centre) if radius else at_centre,
                point_indices=np.zeros(0, dtype=np.int64),
            )
        )
    return images


def test_the_third_neighbour_of_a_ring_stands_two_steps_away() -> None:
    assert view_spacing(ring(10, 36), BOX) == pytest.approx(20)
    assert view_spacing(ring(10, 36, radius=0.5), BOX) == pytest.approx(20)


def test_few_photos() -> None:
    assert view_spacing(ring(10, 2), BOX) == pytest.approx(10)
    assert view_spacing(ring(10, 1), BOX) == view_spacing([], BOX) == 180
    inside = ring(10, 9, radius=0.0)  # in the box's very centre
    assert view_spacing(inside, BOX) == pytest.approx(0)


def test_the_rate_falls_where_photos_stand_far_apart() -> None:
    rate = SpacedShRate(limit=20)
    config = TrainConfig(steps=9, lr_shN=1e-3, mechanisms=(rate,))
    assert rate.at(config, 20) == config
    assert rate.at(config, 40).lr_shN == pytest.approx(1e-3 / 8)
    assert rate.at(config, 180).lr_shN == TrainConfig.lr_shN
    slow = replace(config, lr_shN=1e-5)
    assert rate.at(slow, 180) == slow
    views = PlannedViews(images=(), rois=[BOX], seen=lambda roi: ring(20, 18))
    assert config.planned(views) == rate.at(config, view_spacing(ring(20, 18), BOX)) != config


def test_the_paper_keeps_its_rate() -> None:
    assert preset("paper").roi.get(SpacedShRate) is None
