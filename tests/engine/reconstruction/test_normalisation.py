"""A new model stands upright on a floor at z = 0."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_engine.model.rotations import rotation_entries
from roigs_engine.reconstruction.worker import DISTANCE, floor, normalisation
from tests.poses import look_at

RANDOM = np.random.default_rng(1)


def room() -> np.ndarray:
    """Points of a floor at height 3, a thing on it and some strays."""
    ground = np.column_stack([RANDOM.uniform(-4, 4, (3000, 2)), RANDOM.normal(3, 0.005, 3000)])
    thing = RANDOM.uniform((-0.5, -0.5, 3), (0.5, 0.5, 4.5), (3000, 3))
    strays = RANDOM.uniform((-9, -9, -9), (9, 9, 20), (20, 3))
    return np.concatenate([ground, thing, strays])


def test_a_turned_and_shrunken_model_is_put_upright() -> None:
    w, x, y, z = np.array([0.3, -0.5, 0.7, 0.4]) / np.linalg.norm([0.3, -0.5, 0.7, 0.4])
    turn = np.reshape(rotation_entries(w, x, y, z), (3, 3))
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    eyes = np.column_stack([5 * np.cos(angles), 5 * np.sin(angles), 4 + np.cos(3 * angles)])
    points, target = room(), np.array([0.0, 0, 3.7])
    poses = np.array([look_at(eye, target) for eye in eyes])
    distance = float(np.median(np.linalg.norm(points - eyes[0], axis=1)))
    turned = poses.copy()
    turned[:, :3, :3] = poses[:, :3, :3] @ turn.T
    turned[:, :3, 3] *= 0.1
    matrix = normalisation(turned, 0.1 * points @ turn.T, 0.1 * distance)
    found = 0.1 * points @ turn.T @ matrix[:, :3].T + matrix[:, 3]
    assert np.median(found[:3000, 2]) == pytest.approx(0, abs=0.01)
    height = np.median(found[3000:6000, 2])
    assert height == pytest.approx(0.75 * DISTANCE / distance, rel=0.1)
    assert np.abs(np.median(found[:, :2], axis=0)).max() < 0.01


def test_without_a_floor_the_lowest_points_count() -> None:
    heights = RANDOM.uniform(0, 1, 5000)
    assert floor(heights, 2.0) == pytest.approx(0.02, abs=0.02)
