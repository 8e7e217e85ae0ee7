"""The map that most points went through."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_addon.geometry.common_map import common_map

RANDOM = np.random.default_rng(5)
POINTS = (RANDOM.normal(size=(50_000, 3)) ** 3).astype(np.float32)  # floaters far away
MAP = np.eye(4)
MAP[:3] = RANDOM.normal(size=(3, 4))


def mapped(matrix: np.ndarray) -> np.ndarray:
    return (POINTS @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("matrix", [MAP, np.diag([-1.0, 2, 3, 1]), np.diag([1e-3] * 3 + [1])])
def test_it_is_found_among_points_that_were_moved_too(matrix: np.ndarray, share: float) -> None:
    now = mapped(matrix)
    now[: int(share * len(now))] += (3, 1, 2)
    np.testing.assert_allclose(common_map(POINTS, now), matrix, atol=1e-5 * np.abs(matrix).max())


def test_points_that_stay_have_none() -> None:
    now = POINTS.copy()
    now[:20_000] *= 2
    np.testing.assert_array_equal(common_map(POINTS, now), np.eye(4))


@pytest.mark.parametrize("now", [RANDOM.normal(size=POINTS.shape), POINTS * (1, 1, 0)])
def test_what_is_no_map(now: np.ndarray) -> None:
    np.testing.assert_array_equal(common_map(POINTS, now.astype(np.float32)), np.eye(4))


@pytest.mark.parametrize("count", [0, 1, 4, 10])
def test_few_points_do_not_tell(count: int) -> None:
    found = common_map(POINTS[:count], mapped(MAP)[:count])
    np.testing.assert_array_equal(found, np.eye(4))
