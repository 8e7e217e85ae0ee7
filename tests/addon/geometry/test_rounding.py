"""The distance from the origin at which rounding becomes visible."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_addon.geometry.rounding import rounding

UTM = np.array([5e5, 5e6, 100.0])


def cloud(width: float, middle: np.ndarray | float = 0.0) -> np.ndarray:
    return np.random.default_rng(0).uniform(-width / 2, width / 2, (5000, 3)) + middle


@pytest.mark.parametrize("width", [1.6, 50.0, 1000.0])
def test_map_coordinates_are_too_far(width: float) -> None:
    said = rounding(cloud(width, UTM))
    assert said.startswith("lies 5,000,") and said.endswith("steps of 0.5")


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("away", [0.0, 3.0, 500.0])
def test_units_and_a_usual_origin_do_not_matter(unit: float, away: float) -> None:
    assert rounding(unit * cloud(1.6, away)) == ""


@pytest.mark.parametrize("distance", [100.0, 3e3, 1e5, 5e6])
def test_what_is_said_is_what_is_lost(distance: float) -> None:
    points = cloud(1.6, distance)
    lost = np.abs(points.astype(np.float32) - points).max()
    assert bool(rounding(points)) == (lost > 0.5e-4 * 1.6)
    assert bool(rounding(points.astype(np.float32))) == bool(rounding(points))


def test_nothing_to_compare() -> None:
    assert rounding(np.zeros((0, 3))) == rounding(np.full((1, 3), 5e6)) == ""
    assert rounding(np.zeros((7, 3))) == ""
