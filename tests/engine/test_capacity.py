"""Limits on the Gaussians of a box: observed values, growth, and their schedule."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from roigs_engine.capacity import CHANNELS, PARAMETERS, BoxCapacity, box_capacities
from roigs_engine.config import TrainConfig
from roigs_engine.roi import OrientedBox
from roigs_engine.scene import SfmScene
from tests.engine.synthetic_scene import BOX, make_scene, truth

FREE = TrainConfig(steps=100, densify_in_boxes=True)
SMALL = OrientedBox.axis_aligned("small", [-0.1, -0.1, -0.1], [0.1, 0.1, 0.1])


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(Path(tmp_path_factory.mktemp("photos")), views=4)


def test_the_limit_rises_evenly_and_ends() -> None:
    capacity = BoxCapacity(begin=100, end=300)
    assert [capacity.at(p) for p in (0, 0.25, 0.5, 1, 1.7)] == [100, 150, 200, 300, 300]


def test_no_limit_when_none_is_set(scene: SfmScene) -> None:
    assert box_capacities(truth(), scene.images, [BOX], FREE) is None


def test_parameters_never_outnumber_observed_values(scene: SfmScene) -> None:
    config = replace(FREE, box_capacity=1.0)
    (all_photos,) = box_capacities(truth(), scene.images, [BOX], config) or []
    (one_photo,) = box_capacities(truth(), scene.images[:1], [BOX], config) or []
    pixels = sum(BOX.silhouette(i.camera, i.world_to_camera).sum() for i in scene.images)
    assert all_photos.end == pytest.approx(CHANNELS * pixels / PARAMETERS, rel=0.02)
    assert one_photo.end < all_photos.end / 2
    assert one_photo.begin <= one_photo.end


def test_growth_is_a_share_of_the_model_for_all_boxes_together(scene: SfmScene) -> None:
    model = truth()
    config = replace(FREE, box_growth=0.5)
    (alone,) = box_capacities(model, scene.images, [BOX], config) or []
    assert alone.begin == int(model.in_box(BOX).sum())
    assert alone.end == alone.begin + len(model) // 2
    both = box_capacities(model, scene.images, [BOX, SMALL], config) or []
    gains = [capacity.end - capacity.begin for capacity in both]
    assert len(model) // 2 - 2 <= sum(gains) <= len(model) // 2
    assert gains[0] > 3 * gains[1] > 0
