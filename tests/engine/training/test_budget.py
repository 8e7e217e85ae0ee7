"""Limits on the Gaussians of a box: what the photos show of it, and the schedule."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from roigs_engine.model.scene import SfmScene
from roigs_engine.training.budget import EXPONENT, BoxBudget, box_budgets, budgets_from
from roigs_engine.training.config import TrainConfig
from tests.engine.synthetic_scene import BOX, make_scene, truth

FREE = TrainConfig(steps=100, densify_in_boxes=True)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(Path(tmp_path_factory.mktemp("photos")), views=4)


def test_the_limit_rises_evenly_and_ends() -> None:
    budget = BoxBudget(begin=100, end=300)
    assert [budget.at(p) for p in (0, 0.25, 0.5, 1, 1.7)] == [100, 150, 200, 300, 300]


def test_no_limit_when_none_is_set(scene: SfmScene) -> None:
    assert box_budgets(scene.images, [BOX], FREE) is None


def test_the_limit_grows_with_pixels_but_more_slowly(scene: SfmScene) -> None:
    config = replace(FREE, box_budget=2.0)
    (all_photos,) = box_budgets(scene.images, [BOX], config) or []
    (one_photo,) = box_budgets(scene.images[:1], [BOX], config) or []
    pixels = sum(BOX.silhouette(i.camera, i.world_to_camera).sum() for i in scene.images)
    assert all_photos == pytest.approx(2.0 * pixels**EXPONENT, rel=0.02)
    assert one_photo < all_photos < 4 * one_photo


def test_it_begins_with_what_is_there_or_with_less(scene: SfmScene) -> None:
    model = truth()
    inside = int(model.in_box(BOX).sum())
    many, few = (box_budgets(scene.images, [BOX], replace(FREE, box_budget=b)) for b in (9.0, 0.1))
    (roomy,) = budgets_from(model, [BOX], many or ())
    (tight,) = budgets_from(model, [BOX], few or ())
    assert roomy.begin == inside < roomy.end
    assert tight.begin == tight.end < inside
