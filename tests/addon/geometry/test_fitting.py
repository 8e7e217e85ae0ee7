"""Boxes are fitted to points: outliers stay out, and the floor is found."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_addon.geometry.fitting import floor, is_unsure, tight

RANDOM = np.random.default_rng(0)


def test_outliers_stay_out() -> None:
    thing = RANDOM.uniform((-0.5, -0.2, 0), (0.5, 0.2, 1), (5000, 3))
    dust = RANDOM.uniform(-3, 3, (60, 3))
    low, high = tight(np.concatenate([thing, dust]))
    np.testing.assert_allclose(low, (-0.5, -0.2, 0), atol=0.15)
    np.testing.assert_allclose(high, (0.5, 0.2, 1), atol=0.15)


def test_all_points_of_a_thing_are_in() -> None:
    thing = RANDOM.uniform(-1, 1, (3000, 3)) ** 3  # denser in the middle
    low, high = tight(thing)
    assert ((thing >= low) & (thing <= high)).all(axis=1).mean() > 0.98


@pytest.mark.parametrize("count", [20, 50, 200, 1000, 5000])
def test_fitting_again_takes_no_more_away(count: int) -> None:
    """Few points are far from each other, and are no outliers for that."""
    random = np.random.default_rng(count)
    thing = random.normal(size=(count, 3))
    thing /= np.linalg.norm(thing, axis=1)[:, None]
    low, high = tight(thing)
    assert ((thing >= low) & (thing <= high)).all(axis=1).mean() > 0.98
    for _ in range(3):
        inside = thing[((thing >= low) & (thing <= high)).all(axis=1)]
        again = tight(inside)
        np.testing.assert_allclose(again, (low, high), atol=0.02)
        low, high = again


def test_flat_things_get_some_depth() -> None:
    sheet = RANDOM.uniform(-1, 1, (500, 3)) * (1, 1, 0)
    low, high = tight(sheet)
    assert 0 < high[2] - low[2] < 0.1


@pytest.mark.parametrize("points", [np.zeros((0, 3)), RANDOM.uniform(-1, 1, (5, 3))])
def test_too_few_points_to_fit_to(points: np.ndarray) -> None:
    assert tight(points) is None


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("up", [0, 1, 2])
def test_the_floor_is_where_the_table_is(up: int, sign: int) -> None:
    thing = RANDOM.uniform((-0.4, -0.4, -0.45), (0.4, 0.4, 0.5), (5000, 3))
    table = RANDOM.uniform(-1.5, 1.5, (800, 3)) * (1, 1, 0) + RANDOM.normal(0, 0.003, (800, 3))
    points = np.concatenate([thing, table - (0, 0, 0.45), RANDOM.uniform(-3, 3, (300, 3))])
    turned = np.roll(points * (1, 1, sign), up - 2, axis=1)
    height = floor(turned, np.array([0.5, 0.5, 0.5]), up, sign)
    assert height == pytest.approx(-0.45 * sign, abs=0.01)


def test_nothing_around_is_no_floor() -> None:
    thing = RANDOM.uniform(-0.4, 0.4, (500, 3))
    assert floor(thing, np.array([0.5, 0.5, 0.5]), 2, 1) is None


@pytest.mark.parametrize("seed", range(8))
def test_smooth_parts_are_not_cut_off(seed: int) -> None:
    """A vase: many points on its foot, a few on its glaze, none on its rim."""
    random = np.random.default_rng(seed)
    foot = random.uniform((-0.3, -0.3, -1), (0.3, 0.3, -0.8), (40, 3))
    glaze = random.uniform((-0.3, -0.3, -0.8), (0.3, 0.3, 1), (8, 3))
    half = np.array([0.4, 0.4, 1.1])
    points = np.concatenate([foot, glaze])
    low, high = tight(points, half)
    assert high[2] > 0.85 and (high <= half).all() and (low >= -half * 1.05).all()
    assert low[2] == pytest.approx(-1, abs=0.1)  # there the points are near one another
    assert high[2] >= tight(points)[1][2]


def test_many_points_are_fitted_as_before() -> None:
    thing = RANDOM.uniform(-1, 1, (5000, 3))
    np.testing.assert_allclose(tight(thing, np.full(3, 1.5)), tight(thing), atol=0.01)
    assert not is_unsure(thing) and is_unsure(thing[:50])
