"""The first box: around the main object of the photos."""

from __future__ import annotations

import time

import numpy as np
import pytest

from roigs_engine.formats.foreground import View, foreground_bounds
from tests.addon.colmap_project import ring


def photos(count: int = 24) -> list[View]:
    """Of the origin, from all around."""
    lens = {"width": 64, "height": 48, "fx": 60.0, "fy": 54.0, "cx": 30.0, "cy": 26.0}
    return [View(pose=pose, **lens) for pose in ring(count)]


def room(seed: int = 0, offset: tuple[float, ...] = (0, 0, 0)) -> np.ndarray:
    """An object of side 0.4 at the origin, in a room of side 20 with as many points."""
    random = np.random.default_rng(seed)
    wall = random.uniform(-10, 10, (2000, 3))
    wall[np.arange(2000), random.integers(0, 3, 2000)] = 10
    return np.concatenate([random.uniform(-0.2, 0.2, (2000, 3)), wall]) + offset


def test_the_box_is_around_what_the_photos_show() -> None:
    low, high = foreground_bounds(photos(), room(), np.eye(4))
    np.testing.assert_allclose(low, -0.2, atol=0.06)
    np.testing.assert_allclose(high, 0.2, atol=0.06)


def test_it_is_along_the_axes_of_the_frame_asked_for() -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = 2 * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    matrix[:3, 3] = 1, 2, 3
    low, high = foreground_bounds(photos(), room(), matrix)
    np.testing.assert_allclose((low + high) / 2, (1, 2, 3), atol=0.05)
    np.testing.assert_allclose((high - low) / 2, 0.4, atol=0.1)


def test_what_is_tall_is_whole_though_photos_aim_at_its_foot() -> None:
    random = np.random.default_rng(0)
    tower = random.uniform((-0.2, -0.9, -0.2), (0.2, 0.1, 0.2), (4000, 3))
    upright = np.eye(4)
    upright[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # the photos' y points down
    low, high = foreground_bounds(photos(), np.concatenate([tower, room()[2000:]]), upright)
    np.testing.assert_allclose(high, (0.2, 0.2, 0.9), atol=0.12)
    assert -0.25 < low[2] < 0


@pytest.mark.parametrize("count", [0, 5])
def test_too_little_to_tell(count: int) -> None:
    assert foreground_bounds(photos(), room()[:count], np.eye(4)) is None
    assert foreground_bounds([], room(), np.eye(4)) is None
    behind = -photos(1)[0].pose[2, :3] * 100 + room()[:50]
    assert foreground_bounds(photos(1), behind, np.eye(4)) is None


def test_many_photos_take_no_longer_than_few() -> None:
    started = time.process_time()
    assert foreground_bounds(photos(2000), np.tile(room(), (100, 1)), np.eye(4))
    assert time.process_time() - started < 2


def test_a_thin_top_is_inside() -> None:
    random = np.random.default_rng(0)
    upright = np.eye(4)
    upright[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    foot = random.uniform((-0.2, -0.1, -0.2), (0.2, 0.1, 0.2), (4000, 3))
    neck = random.uniform((-0.03, -0.6, -0.03), (0.03, 0.1, 0.03), (70, 3))
    _, high = foreground_bounds(photos(), np.concatenate([foot, neck, room()[2000:]]), upright)
    assert high[2] > 0.4


def on_a_table(*things: tuple[float, float]) -> np.ndarray:
    """Boxes of side 0.3 on a table in a room, at these places."""
    random = np.random.default_rng(0)
    table = random.uniform((-1, -1, 0), (1, 1, 0.005), (3000, 3))
    boxes = [random.uniform((x, y, 0), (x + 0.3, y + 0.3, 0.3), (500, 3)) for x, y in things]
    return np.concatenate([table, *boxes, room()[2000:]])


UPRIGHT = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
"""From a frame whose y axis points down, as the photos' does."""


@pytest.mark.parametrize("scale", [0.01, 1, 100])
def test_of_things_on_a_table_one_is_in_the_box_and_the_table_is_not(scale: float) -> None:
    points = on_a_table((-0.1, -0.1), (0.45, -0.1), (-0.1, -0.7)) @ UPRIGHT[:3, :3]
    views = photos()
    for view in views:
        view.pose[:3, 3] *= scale
    low, high = foreground_bounds(views, scale * points, UPRIGHT)
    np.testing.assert_allclose(low / scale, (-0.1, -0.1, 0), atol=0.03)
    np.testing.assert_allclose(high / scale, (0.2, 0.2, 0.3), atol=0.03)


def test_a_table_that_is_not_quite_level_is_still_the_table() -> None:
    angle = np.radians(8)
    tilt = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    points = on_a_table((-0.15, -0.15), (0.5, 0.3)) @ tilt.T @ UPRIGHT[:3, :3]
    low, high = foreground_bounds(photos(), points, UPRIGHT)
    assert (high - low < 0.42).all()


def test_what_floats_or_lies_flat_has_a_box_too() -> None:
    """As without a table: there is nothing to tell them from."""
    points = on_a_table() @ UPRIGHT[:3, :3]
    low, high = foreground_bounds(photos(), points, UPRIGHT)
    assert (high > low).all() and high[0] - low[0] > 0.5
