"""How far apart photos stand around a box, and the rate that follows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.run.presets import preset
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.view_spacing import (
    STEPS,
    detail_spacing,
    learning_rates_for_spacing,
    view_spacing,
)
from tests.poses import look_at

BOX = OrientedBox.axis_aligned("thing", [1, 1, 1], [3, 3, 3])


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


def test_the_spacing_of_the_detail_is_that_of_the_close_ups() -> None:
    far, close = ring(10, 36, radius=40.0), ring(40, 9, radius=4.0)
    assert detail_spacing(far, BOX) == pytest.approx(20)
    assert detail_spacing(far + close, BOX) == pytest.approx(80)
    assert view_spacing(far + close, BOX) < 20
    one = close[:1]
    assert detail_spacing(far + one, BOX) == pytest.approx(180)  # it holds most of the pixels
    assert detail_spacing(one, BOX) == detail_spacing([], BOX) == 180
    inside = ring(10, 1, radius=0.05)  # shows no more pixels than it has
    assert detail_spacing(ring(10, 36) + inside, BOX) == pytest.approx(20)


def test_the_rate_falls_where_photos_stand_far_apart() -> None:
    config = TrainConfig(steps=9, lr_shN=1e-3, lr_shN_spacing=20)
    assert learning_rates_for_spacing(config, 20, 20) == config
    assert learning_rates_for_spacing(config, 40, 40).lr_shN == pytest.approx(1e-3 / 8)
    assert learning_rates_for_spacing(config, 180, 180).lr_shN == TrainConfig.lr_shN
    slow = replace(config, lr_shN=1e-5)
    assert learning_rates_for_spacing(slow, 180, 180) == slow


def test_close_ups_far_apart_lower_the_rate_of_a_long_stage_only() -> None:
    short = TrainConfig(steps=STEPS, lr_shN=1e-3, lr_shN_spacing=20)
    long = replace(short, steps=2 * STEPS)
    assert learning_rates_for_spacing(short, 20, 90) == short
    assert learning_rates_for_spacing(long, 20, 90).lr_shN == pytest.approx(5e-4)
    assert learning_rates_for_spacing(long, 40, 90).lr_shN == pytest.approx(1e-3 / 8)


def test_the_paper_keeps_its_rate() -> None:
    paper = preset("paper").roi
    assert learning_rates_for_spacing(paper, 180, 180) == paper
