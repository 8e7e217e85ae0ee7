"""Floor, size and origin of a scene."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_addon.geometry.placing import (
    askew,
    centring,
    levelling,
    plane_through,
    scaling,
    turn_of,
)
from tests.addon.colmap_project import ring

TILTED = np.array([[0, 0, 1.0], [1, 0, 1.4], [0, 1, 0.8]])
ABOVE = np.array([[0, 0, 5.0], [1, 1, 6], [-1, 1, 5]])


def moved(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def test_three_points_become_the_floor() -> None:
    plane = plane_through(TILTED)
    assert plane is not None
    matrix = levelling(plane, ABOVE)
    after = moved(matrix, TILTED)
    np.testing.assert_allclose(after[:, 2], 0, atol=1e-12)
    np.testing.assert_allclose(after.mean(axis=0)[:2], TILTED.mean(axis=0)[:2])
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    assert moved(matrix, ABOVE)[:, 2].min() > 1
    over = moved(levelling(plane, ABOVE, flip=True), ABOVE)
    assert over[:, 2].max() < -1


@pytest.mark.parametrize("upside_down", [False, True])
def test_cameras_are_above_the_floor(upside_down: bool) -> None:
    """Also in a scene that lies on its head."""
    plane, sign = plane_through(TILTED), -1.0 if upside_down else 1.0
    assert plane is not None
    after = moved(levelling(plane, ABOVE * (1, 1, sign)), ABOVE * (1, 1, sign))
    assert after[:, 2].min() > 1
    none = levelling(plane, np.empty((0, 3)))
    assert (none @ [0, 0, 1, 0])[2] > 0


def test_outliers_do_not_tilt_the_floor() -> None:
    random = np.random.default_rng(0)
    floor = random.uniform(-2, 2, (600, 3)) * (1, 1, 0) + random.normal(0, 0.005, (600, 3))
    things = random.uniform((-1, -1, 0), (1, 1, 2), (350, 3))
    plane = plane_through(np.concatenate([things, floor]))
    assert plane is not None
    assert np.degrees(np.arccos(abs(plane.normal[2]))) < 0.3
    assert abs(plane.point[2]) < 0.01


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("count", [4, 5, 20])
def test_few_points_on_a_plane(count: int, size: float) -> None:
    random = np.random.default_rng(count)
    points = size * (random.uniform(-1, 1, (count, 3)) * (1, 1, 0) + (7, 0, 3))
    plane = plane_through(points)
    assert plane is not None and abs(plane.normal[2]) == pytest.approx(1)


@pytest.mark.parametrize(
    "points",
    [np.empty((0, 3)), TILTED[:2], np.zeros((3, 3)), np.arange(9.0).reshape(3, 3), np.ones((9, 3))],
)
def test_points_that_are_no_plane(points: np.ndarray) -> None:
    assert plane_through(points) is None


def test_a_known_length() -> None:
    a, b = np.array([1.0, 2, 3]), np.array([1.0, 2, 7])
    matrix = scaling(a, b, 0.2)
    assert matrix is not None
    first, second = moved(matrix, np.array([a, b]))
    assert np.linalg.norm(second - first) == pytest.approx(0.2)
    np.testing.assert_array_equal(moved(matrix, np.zeros((1, 3))), np.zeros((1, 3)))
    assert scaling(a, a, 0.2) is None


def corners(low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
    return np.array(
        [
            [x, y, z]
            for x, y, z in np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)
        ]
    )


def test_the_footprint_of_a_box_goes_to_the_origin() -> None:
    table = centring(corners((1, 2, 0.7), (3, 3, 1.7)))
    np.testing.assert_allclose(table[:3, 3], (-2, -2.5, -0.7))
    floor = centring(corners((1, 2, -0.03), (3, 3, 1)))
    np.testing.assert_allclose(floor[:3, 3], (-2, -2.5, 0))
    shelf = centring(corners((1, 2, 0.7), (3, 3, 1.7)), keep_height=True)
    np.testing.assert_allclose(shelf[:3, 3], (-2, -2.5, 0))


@pytest.mark.parametrize("degrees", [0, 10, 45, 90])
def test_how_far_a_floor_is_from_level(degrees: float) -> None:
    angle = np.radians(degrees)
    matrix = np.eye(4)
    matrix[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    assert turn_of(matrix) == pytest.approx(degrees, abs=1e-5)
    level = np.diag([1.0, -1.0, -1.0, 1.0])  # to z up; `ring` has y down
    level[1:3, 1:3] = [[0, 1], [-1, 0]]
    poses = ring(12) @ np.linalg.inv(level)
    assert askew(matrix, poses) == pytest.approx(degrees, abs=0.5)
    assert askew(matrix, np.empty((0, 4, 4))) == 0
