"""Gaussians that fill a view between photos are removed if no photo shows them; others stay."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import PosedImage
from roigs_engine.training.floaters import (
    MOST_VIEWS,
    fills_only_between,
    views_between,
)
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


def fog(model: Gaussians, images: list[PosedImage]) -> list[bool]:
    views = views_between(images, OBJECT)
    return fills_only_between(model, views, shown(model, images)).tolist()


def test_fog_before_a_view_between_two_photos_goes_and_the_object_stays() -> None:
    images = ring(10)
    hidden = at(0.05, 0.9 * DISTANCE), 0.05  # between the first two, beside both pictures
    model = gaussians((np.zeros(3), 0.3), hidden)
    assert not sees(images[0], hidden[0]) and not sees(images[1], hidden[0])
    assert fog(model, images) == [False, True]


def test_what_a_photo_shows_as_large_stays() -> None:
    images = ring(10)
    before_a_photo = at(0.0, 0.95 * DISTANCE), 0.05
    assert fog(gaussians(before_a_photo), images) == [False]


def test_a_view_close_to_the_scene_is_not_used() -> None:
    """Two photos with a pillar between them: a camera in the pillar would see nothing else."""
    target = np.array([0.0, 8.0, 0.0])
    images = [photo("a", np.array([-2.0, 0, 0]), target), photo("b", np.array([2.0, 0, 0]), target)]
    pillar = OBJECT * 0.5  # at the origin, half way
    far_away = OBJECT + target
    used, less = (
        views_between(images, points) for points in (far_away, np.concatenate([pillar, far_away]))
    )
    assert len(used) == 3 + 8
    assert len(less) < len(used)


def test_fog_beside_a_photo_far_from_the_others_goes() -> None:
    """Between photos there is no view of it: it hangs above a photo."""
    images = ring(10)
    above = images[0].centre - 0.7 * images[0].world_to_camera[1, :3]
    hidden = above + 0.1 * (np.zeros(3) - above), 0.03
    assert not any(sees(image, hidden[0]) for image in images[:2])
    assert fog(gaussians((np.zeros(3), 0.3), hidden), images) == [False, True]


def test_a_photo_alone_has_no_views_and_opposite_ones_none_between_them() -> None:
    assert views_between(ring(1), OBJECT) == ()
    assert len(views_between(ring(2), OBJECT)) == 8  # beside them only


def test_views_of_many_photos_are_limited_and_of_few_are_three_per_pair() -> None:
    assert len(views_between(ring(400), OBJECT)) == 2 * MOST_VIEWS
    assert len(views_between(ring(3, 24), OBJECT)) == 9 + 12


def test_without_points_all_views_are_used() -> None:
    assert len(views_between(ring(3, 24), NO_POINTS)) == 9 + 12


def test_the_unit_of_the_world_does_not_matter() -> None:
    model = gaussians((np.zeros(3), 0.3), (at(0.05, 0.9 * DISTANCE), 0.05))
    scale = 1024.0
    scaled = {"means": model.means * scale, "log_scales": model.log_scales + np.log(scale)}
    images = [photo(image.name, image.centre * scale) for image in ring(10)]
    views = views_between(images, OBJECT * scale)
    assert len(views) == len(views_between(ring(10), OBJECT))
    larger = Gaussians(**model.tensors() | scaled)
    assert fills_only_between(larger, views, shown(larger, images)).tolist() == [False, True]


def test_it_can_be_stopped() -> None:
    stopping = Context(should_stop=lambda: True)
    model, images = gaussians((np.zeros(3), 0.3)), ring(10)
    views = views_between(images, OBJECT)
    with pytest.raises(Stopped):
        fills_only_between(model, views, shown(model, images), stopping)


def test_nothing_changes_for_a_model_without_gaussians() -> None:
    images = ring(10)
    none = fills_only_between(
        gaussians(), views_between(images, OBJECT), shown(gaussians(), images)
    )
    assert none.shape == (0,) and none.dtype == torch.bool
