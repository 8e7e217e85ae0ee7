"""Gaussians among the cameras where no photo looks are removed; real ones stay."""

from __future__ import annotations

import numpy as np

from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import Float64, PosedImage
from roigs_engine.training.floaters import LEAST, hangs_among_cameras
from tests.engine.training.floaters.photos import (
    DISTANCE,
    NO_POINTS,
    OBJECT,
    at,
    gaussians,
    photo,
    ring,
    sees,
    shown,
)

BESIDE = at(0.05, 0.9 * DISTANCE), 0.05
"""A ball between the first two of four photos, outside all frames."""


def hangs(model: Gaussians, images: list[PosedImage], points: Float64 = OBJECT) -> list[bool]:
    return hangs_among_cameras(model, images, points, shown(model, images)).tolist()


def test_a_ball_near_a_camera_that_no_photo_shows_goes_and_the_object_stays() -> None:
    images = ring(4, 10)
    assert not any(sees(image, BESIDE[0]) for image in images)
    assert hangs(gaussians((np.zeros(3), 0.3), BESIDE), images) == [False, True]


def test_what_a_photo_shows_as_large_stays() -> None:
    before_a_photo = at(0.0, 0.9 * DISTANCE), 0.05
    assert hangs(gaussians(before_a_photo), ring(4, 10)) == [False]


def test_a_faint_blot_in_photos_from_far_away_goes() -> None:
    """As with few photos: one from afar shows it small, and one beside it would see little else."""
    near = photo("near", at(0.0), target=at(0.25, 100.0))
    far = photo("far", at(0.5, 10 * DISTANCE))
    blot = at(0.0, 0.9 * DISTANCE), 0.05
    assert sees(far, blot[0]) and not sees(near, blot[0])
    assert hangs(gaussians(blot), [near, far]) == [True]


def test_haze_that_photos_show_from_afar_goes() -> None:
    """They show more of it than a speck, but a camera beside it would see nothing else."""
    near = photo("near", at(0.0), target=at(0.25, 100.0))
    far = photo("far", at(0.5, 2 * DISTANCE))
    haze = gaussians((at(0.0, 0.9 * DISTANCE), 0.1))
    assert LEAST < float(shown(haze, [near, far])) < 1 / 16
    assert hangs(haze, [near, far]) == [True]


def test_what_is_near_the_scene_stays_though_no_photo_looks() -> None:
    points = np.concatenate([OBJECT, OBJECT + BESIDE[0]])
    assert hangs(gaussians(BESIDE), ring(4, 10), points) == [False]


def test_what_is_small_even_from_the_nearest_camera_stays() -> None:
    assert hangs(gaussians((BESIDE[0], 0.001)), ring(4, 10)) == [False]


def test_without_points_nothing_hangs() -> None:
    assert hangs(gaussians(BESIDE), ring(4, 10), NO_POINTS) == [False]


def test_a_ball_at_a_cameras_very_place() -> None:
    images = ring(4, 10)
    assert hangs(gaussians((images[0].centre, 0.05)), images) == [True]


def test_the_unit_of_the_world_does_not_matter() -> None:
    scale = 1024.0
    images = [photo(image.name, image.centre * scale) for image in ring(4, 10)]
    model = gaussians((np.zeros(3), 0.3 * scale), (BESIDE[0] * scale, BESIDE[1] * scale))
    assert hangs(model, images, OBJECT * scale) == [False, True]


def test_nothing_happens_without_gaussians() -> None:
    assert hangs(gaussians(), ring(4, 10)) == []
