"""The simulation of a batch on many machines."""

from __future__ import annotations

import pytest

from benchmarks.cluster_model import START, World, simulate

EQUAL = [900.0] * 200


def test_machines_that_are_never_lost_or_slow_reach_the_bound() -> None:
    run = simulate(EQUAL, World(10, lost=0, slow=0))
    assert run.bound == pytest.approx(20 * 900)
    assert run.seconds == pytest.approx(20 * (900 + START)) and run.lost == 0
    assert simulate([50.0], World(10, lost=0, slow=0)).seconds == 50 + START


def test_lost_machines_cost_little_and_slow_ones_are_left() -> None:
    lossy = simulate(EQUAL, World(10, slow=0))
    assert 1 <= lossy.seconds / lossy.bound < 1.15
    stay, move = (
        simulate(EQUAL, World(50, lost=0, moves=moves)).seconds for moves in (False, True)
    )
    assert move < 0.9 * stay


def test_no_machine_left() -> None:
    with pytest.raises(ValueError, match="all machines are lost"):
        simulate(EQUAL, World(1, lost=100.0))
