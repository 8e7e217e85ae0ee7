"""Near and far thirds of few and many photos; gains on single photos."""

from __future__ import annotations

import pytest

from roigs_engine.evaluation.scores import Gains, mean, near_and_far


@pytest.mark.parametrize(
    ("count", "third"), [(0, 0), (2, 0), (3, 1), (4, 1), (5, 2), (6, 2), (7, 2), (8, 3), (31, 10)]
)
def test_thirds_are_disjoint_and_sorted(count: int, third: int) -> None:
    distances = {f"{k:02}": float((7 * k) % count) for k in range(count)}
    near, far = near_and_far(distances)
    assert len(near) == len(far) == third
    assert not set(near) & set(far)
    order = sorted(distances, key=lambda name: (distances[name], name))
    assert near == tuple(order[:third])
    assert far == tuple(order[count - third :])


def test_equal_distances_go_by_name() -> None:
    assert near_and_far({"c": 1.0, "b": 1.0, "a": 1.0}) == (("a",), ("c",))


def test_gains_of_single_photos() -> None:
    gains = Gains.of({"a": 0.5, "b": -0.25, "c": 0.0, "d": 2.0})
    assert gains == Gains(
        peak_view="d", peak_gain=2.0, worst_view="b", worst_gain=-0.25, won_share=0.5
    )
    assert Gains.of({"a": 1.0}) == Gains(
        peak_view="a", peak_gain=1, worst_view="a", worst_gain=1, won_share=1
    )
    assert Gains.of({}) == Gains()


def test_mean() -> None:
    assert mean([1.0, 2.0]) == 1.5
    assert mean([]) is None
