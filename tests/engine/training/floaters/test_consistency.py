"""Gaussians confirmed by photos, among Gaussians at known places."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import PosedImage
from roigs_engine.training.floaters import consistent_across_views
from tests.engine.synthetic_scene import BOX, CAMERA
from tests.poses import look_at

DISTANCE = 4.0
NO_POINTS = np.zeros((0, 3))


def ring(count: int) -> list[PosedImage]:
    """Photos from a circle around the box."""
    images = []
    for k in range(count):
        pose = look_at(eye(k, count) * DISTANCE, np.zeros(3))
        indices = np.zeros(0, dtype=np.int64)
        images.append(
            PosedImage(
                name=f"{k}.png",
                path=Path(),
                camera=CAMERA,
                world_to_camera=pose,
                point_indices=indices,
            )
        )
    return images


def eye(k: int, count: int = 20) -> np.ndarray:
    angle = 2 * np.pi * k / count
    return np.array([np.cos(angle), np.sin(angle), 0.0])


SIDE = ring(20)[:6]  # each alone sees what stands close before it


def balls(*places: object, opacity: float = 0.9) -> Gaussians:
    """A small ball at each place, given as x, y, z."""
    count = len(places)
    logit = float(np.log(opacity / (1 - opacity)))
    arrays = {
        "means": np.array(places).reshape(count, 3),
        "quats": np.tile([1.0, 0, 0, 0], (count, 1)),
        "log_scales": np.full((count, 3), np.log(0.05)),
        "logit_opacities": np.full(count, logit),
        "sh": np.zeros((count, 16, 3)),
    }
    return Gaussians.from_arrays({name: a.astype(np.float32) for name, a in arrays.items()})


def kept(
    model: Gaussians,
    min_views: int = 3,
    images: list[PosedImage] | None = None,
    points: np.ndarray = NO_POINTS,
    rois: tuple[OrientedBox, ...] = (BOX,),
) -> list[bool]:
    return consistent_across_views(model, images or SIDE, rois, points, min_views).tolist()


def test_a_floater_before_one_camera_goes_and_background_stays() -> None:
    close, behind = eye(0) * 0.85 * DISTANCE, eye(0) * -2 * DISTANCE
    to_the_side = np.array([0.0, 0.0, 0.3])
    model = balls((0, 0, 0), close + to_the_side, behind + to_the_side)
    assert kept(model) == [True, False, True]
    assert kept(model, min_views=1) == [True, True, True]


def test_what_enough_photos_show_before_the_box_stays() -> None:
    shown_by_three = ring(48)[:3]  # 7.5 degrees apart
    model = balls(eye(1, 48) * 0.6 * DISTANCE)
    elsewhere = ring(48)[10:12]  # do not see it
    assert kept(model, 3, shown_by_three + elsewhere) == [True]
    assert kept(model, 4, shown_by_three + elsewhere) == [False]


def test_what_is_buried_in_the_box_goes_and_what_is_out_of_sight_stays() -> None:
    shell = balls(*(np.array(eye(k, 40)) * r for k in range(40) for r in (0.3, 0.35, 0.4)))
    shell = replace(shell, log_scales=shell.log_scales + 1.5, logit_opacities=shell.quats[:, 0] * 9)
    in_box = Gaussians.concatenate([balls((0, 0, 0)), balls((0, 0, 0.5), opacity=0.003)])
    model = Gaussians.concatenate([in_box, balls((0, 0, 99)), shell])
    mask = kept(model)
    assert mask[:3] == [False, False, True]
    assert any(mask[3:])


def test_a_box_behind_the_camera_has_nothing_before_it() -> None:
    away = [
        replace(image, world_to_camera=np.diag([-1.0, 1, -1, 1]) @ image.world_to_camera)
        for image in SIDE
    ]
    assert kept(balls(eye(0) * 1.5 * DISTANCE), 3, away) == [True]


def test_a_photo_without_a_box_in_sight_says_nothing_of_what_is_before_one() -> None:
    looking_past = replace(
        SIDE[0], world_to_camera=look_at(eye(0) * DISTANCE, np.array([DISTANCE, 9.0, 0.0]))
    )
    wall = balls(eye(0) * DISTANCE + np.array([0.0, 1.0, 0.0]))
    assert kept(wall, 3, [looking_past, *SIDE[3:]]) == [True]


def test_of_fewer_photos_all_must_show_it() -> None:
    model = balls(eye(1, 48) * 0.6 * DISTANCE)
    assert kept(model, 4, ring(48)[:3]) == [True]


def test_every_box_counts() -> None:
    near = OrientedBox.between("near", eye(0) * 2.9 - 0.2, eye(0) * 2.9 + 0.2)
    model = balls(eye(0) * 2.8)
    one_sees_it = [SIDE[0], *ring(20)[4:6]]
    assert kept(model, 3, one_sees_it) == [False]
    assert kept(model, 3, one_sees_it, rois=(BOX, near)) == [True]


def turned_away(image: PosedImage) -> PosedImage:
    """To the other side, where it observes 50 points."""
    pose = look_at(image.centre, 2 * image.centre)
    return replace(image, world_to_camera=pose, point_indices=np.arange(50))


WALL = eye(0) * 2 * DISTANCE + np.random.default_rng(0).normal(scale=0.1, size=(50, 3))
NO_BOX_IN_SIGHT = [turned_away(image) for image in (SIDE[0], *SIDE[3:])]
"""The first photo looks at the wall; what stands before it is shown by no other one."""


def test_in_the_air_before_the_scene_few_photos_do_not_suffice() -> None:
    floater, standing = balls(eye(0) * 1.2 * DISTANCE), balls(eye(0) * 1.8 * DISTANCE)
    assert kept(floater, 3, NO_BOX_IN_SIGHT, WALL) == [False]
    assert kept(standing, 3, NO_BOX_IN_SIGHT, WALL) == [True]
    assert kept(floater, 1, NO_BOX_IN_SIGHT, WALL) == [True]
    something = np.repeat(eye(0)[None] * 1.2 * DISTANCE, 10, axis=0)
    assert kept(floater, 3, NO_BOX_IN_SIGHT, np.concatenate([WALL, something])) == [True]


def test_without_points_nothing_is_in_the_air() -> None:
    floater = balls(eye(0) * 1.2 * DISTANCE)
    blind = [replace(i, point_indices=np.zeros(0, dtype=np.int64)) for i in NO_BOX_IN_SIGHT]
    assert kept(floater, 3, blind, WALL) == [True]
    assert kept(floater, 3, blind, NO_POINTS) == [True]


def test_background_without_points_behind_the_scene_stays() -> None:
    """As a bare wall that few photos show; it is nearer to cameras than to any point."""
    near = eye(0) * 0.9 * DISTANCE + np.random.default_rng(0).normal(scale=0.1, size=(50, 3))
    images = [replace(image, point_indices=np.arange(50)) for image in (SIDE[0], *SIDE[3:])]
    wall = balls(eye(0) * -1.4 * DISTANCE + np.array([0.0, 0.0, 0.4]))
    assert kept(wall, 3, [*images, *ring(20)[9:12]], near)[0]


def test_what_no_photo_shows_in_the_air_stays() -> None:
    """A model that was moved there, or what a new view needs."""
    beside = balls(eye(0) * 1.1 * DISTANCE + np.array([0.0, 0.0, 2.0]))
    assert kept(beside, 3, NO_BOX_IN_SIGHT, WALL) == [True]


def test_in_the_air_enough_photos_suffice() -> None:
    images = [*map(turned_away, ring(400)[:3]), *NO_BOX_IN_SIGHT[1:]]
    model = balls(eye(1, 400) * 1.2 * DISTANCE)
    assert kept(model, 3, images, WALL) == [True]
    assert kept(model, 4, images, WALL) == [False]


def test_it_can_be_stopped() -> None:
    stopping = Context(should_stop=lambda: True)
    with pytest.raises(Stopped):
        consistent_across_views(balls((0, 0, 0)), SIDE, [BOX], NO_POINTS, 3, stopping)
