"""Gaussians below a brush, and those of them in front."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_addon.geometry.brush import below, in_front
from roigs_addon.geometry.picking import Sight

SIZE = (400, 300)
PERSPECTIVE = np.array([[2, 0, 0, 0], [0, 2 * 4 / 3, 0, 0], [0, 0, -1, -0.2], [0, 0, -1, 0]], float)
ORTHO = np.array([[0.5, 0, 0, 0], [0, 0.5 * 4 / 3, 0, 0], [0, 0, -0.01, 0], [0, 0, 0, 1]], float)


def wall(z: float, side: float = 1.0, count: int = 60) -> np.ndarray:
    """Points of a square at depth z."""
    line = np.linspace(-side, side, count)
    x, y = np.meshgrid(line, line)
    return np.column_stack((x.ravel(), y.ravel(), np.full(count**2, -z)))


def test_circles() -> None:
    places = np.array([(10, 10), (14, 10), (10, 16), (50, 50), (np.nan, 1)], float)
    seen = np.array([True, True, True, True, True])
    assert below(places, seen, [(10, 10)], 5).tolist() == [True, True, False, False, False]
    assert below(places, seen, [(10, 10), (50, 50)], 6).tolist() == [True, True, True, True, False]
    seen[0] = False
    assert not below(places, seen, [(10, 10)], 5)[0]


@pytest.mark.parametrize("projection", [PERSPECTIVE, ORTHO], ids=["perspective", "orthographic"])
def test_a_wall_hides_what_is_behind_it(projection: np.ndarray) -> None:
    sight = Sight(np.eye(4), projection, SIZE)
    near, far = wall(4.0), wall(6.0, side=0.5)
    points = np.concatenate((near, far))
    sizes = np.full(len(points), 0.03)
    found = in_front(points, sizes, np.full(len(points), 0.9), sight)
    assert found[: len(near)].all()
    assert found[len(near) :].mean() < 0.02
    clear = np.concatenate((np.full(len(near), 0.02), np.full(len(far), 0.9)))
    assert in_front(points, sizes, clear, sight).all()


def test_a_speck_hides_nothing() -> None:
    sight = Sight(np.eye(4), PERSPECTIVE, SIZE)
    points = np.concatenate((np.array([[0, 0, -2.0]]), wall(4.0)))
    sizes = np.full(len(points), 0.03)
    sizes[0] = 0.002
    assert in_front(points, sizes, np.full(len(points), 0.99), sight).all()


def test_what_is_outside_the_view() -> None:
    sight = Sight(np.eye(4), PERSPECTIVE, SIZE)
    points = np.array([(0, 0, 5.0), (50, 0, -5.0), (0, 0, 0)])
    assert not in_front(points, np.ones(3), np.ones(3), sight).any()
    assert in_front(np.empty((0, 3)), np.empty(0), np.empty(0), sight).shape == (0,)
