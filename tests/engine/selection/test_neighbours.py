"""Nearest neighbours with numpy alone, against those of scipy's tree."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from roigs_engine.selection.coverage import nearest_neighbours


def spread(kind: str, rng: np.random.Generator) -> np.ndarray:
    points = rng.normal(size=(2000, 3))
    if kind == "plane":
        points[:, 2] = 0
    elif kind == "line":
        points[:, 1:] = 7.0
    elif kind == "far away":
        points = points * [1e-3, 1e-2, 1e-3] + 5e3
    elif kind == "clumps":
        points = points * 1e-4 + rng.integers(0, 4, (2000, 1)) * 100.0
    elif kind == "stray":  # enough for many leaves, which the few in the void would all look at
        points = np.concatenate([rng.normal(size=(7900, 3)), rng.uniform(-60, 60, (100, 3))])
    elif kind == "few":
        points = points[:16]
    return points


@pytest.mark.parametrize("kind", ["ball", "plane", "line", "far away", "clumps", "stray", "few"])
def test_neighbours_are_the_nearest(kind: str) -> None:
    points = spread(kind, np.random.default_rng(3))
    found = nearest_neighbours(points, 16)
    distance = np.linalg.norm(points[found] - points[:, None], axis=2)
    expected = cKDTree(points).query(points, k=16)[0]
    size = np.ptp(points, axis=0).max()
    assert np.allclose(np.sort(distance, axis=1), expected, rtol=1e-6, atol=1e-9 * size)
    assert all(len(set(row)) == 16 for row in found.tolist())


def test_points_in_one_place_are_their_own_neighbours() -> None:
    found = nearest_neighbours(np.full((300, 3), 2.5), 16)
    assert ((found >= 0) & (found < 300)).all()
