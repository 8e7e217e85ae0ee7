"""Orders of photos: shares that hold exactly, epochs that are permutations, no hidden state."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roigs_engine.selection import split
from roigs_engine.training import photo_order

SHARES = st.sampled_from([0.0, 0.1, 0.25, 1 / 3, 0.5, 0.7, 0.75, 0.9, 1.0])
NAMES = st.lists(st.sampled_from("abcdefgh"), unique=True)


@given(st.integers(1, 20), st.integers(0, 200))
def test_ordered_cycles_in_the_order_given(count: int, step: int) -> None:
    order = photo_order.PhotoOrder(kind="ordered", count=count)
    assert order.photo_at()(step) == range(count)[step % count]


@given(st.integers(1, 20), st.integers(0, 2**31), st.integers(0, 50))
def test_every_epoch_of_shuffled_is_a_permutation(count: int, seed: int, epoch: int) -> None:
    photo_at = photo_order.shuffled(range(100, 100 + count), seed)
    drawn = [photo_at(epoch * count + k) for k in range(count)]
    assert sorted(drawn) == list(range(100, 100 + count))


@given(st.integers(1, 12), st.integers(0, 1000), st.lists(st.integers(0, 300), max_size=40))
def test_shuffled_depends_on_seed_and_step_only(count: int, seed: int, steps: list[int]) -> None:
    jumping = photo_order.shuffled(range(count), seed)
    for step in steps:
        assert jumping(step) == photo_order.shuffled(range(count), seed)(step)


def test_shuffled_differs_between_epochs_and_seeds() -> None:
    def epoch(seed: int, number: int) -> list[int]:
        photo_at = photo_order.shuffled(range(30), seed)
        return [photo_at(30 * number + k) for k in range(30)]

    assert epoch(0, 0) != epoch(0, 1)
    assert epoch(0, 0) != epoch(1, 0)


@given(SHARES, st.integers(0, 500))
def test_mixed_gives_each_source_exactly_its_share(share: float, steps: int) -> None:
    photo_at = photo_order.mixed(lambda k: k, lambda k: -1 - k, share)
    drawn = [photo_at(step) for step in range(steps)]
    second = [value for value in drawn if value < 0]
    assert len(second) == int(steps * share + 1e-9)
    # Each source is asked for its own steps 0, 1, 2, …: none is skipped, none comes twice.
    assert second == [-1 - k for k in range(len(second))]
    assert [value for value in drawn if value >= 0] == list(range(steps - len(second)))


@given(st.sampled_from([0.2, 0.25, 0.5]), st.integers(0, 300))
def test_mixed_is_spread_evenly(share: float, start: int) -> None:
    photo_at = photo_order.mixed(lambda k: 0, lambda k: 1, share)
    window = round(1 / share)
    assert sum(photo_at(start + k) for k in range(window)) == 1


@given(st.lists(NAMES, max_size=4))
def test_interleaved_has_every_name_once_and_keeps_ranks(orders: list[list[str]]) -> None:
    merged = split.interleaved(orders)
    assert len(merged) == len(set(merged))
    assert set(merged) == {name for order in orders for name in order}
    rank = {n: min(o.index(n) for o in orders if n in o) for n in merged}
    assert all(rank[a] <= rank[b] for a, b in pairwise(merged))


def test_interleaved_takes_turns() -> None:
    assert split.interleaved([["a", "b", "c"], ["x", "b"]]) == ["a", "x", "b", "c"]
    assert split.interleaved([]) == []


@given(NAMES, SHARES)
def test_reserved_keeps_the_share_with_the_scene(order: list[str], share: float) -> None:
    held = split.reserved([order], share)
    assert held <= set(order)
    assert len(order) - len(held) == int(len(order) * share + 1e-9)


def test_reserved_half_is_every_second_one_and_any_roi_reserves() -> None:
    assert split.reserved([["a", "b", "c", "d"]], 0.5) == {"a", "c"}
    assert split.reserved([["a", "b"], ["b", "c"]], 0.5) == {"a", "b"}
    assert split.reserved([["a", "b"]], 1.0) == set()
    assert split.reserved([["a", "b"]], 0.0) == {"a", "b"}


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_mixed_with_one_source_never_asks_the_other(share: float) -> None:
    def never(step: int) -> int:
        raise AssertionError(step)

    sources = (never, abs) if share else (abs, never)
    assert [photo_order.mixed(*sources, share)(step) for step in range(5)] == list(range(5))
