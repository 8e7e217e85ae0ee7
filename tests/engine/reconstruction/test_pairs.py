"""Pairs of photos to match, and the similarity of photos."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_engine.context import QUIET
from roigs_engine.reconstruction import pairs

NAMES = [f"{number:02}.jpg" for number in range(12)]


def ring(count: int, shared: int = 40, own: int = 20) -> list[pairs.Descriptors]:
    """Descriptors of photos around something: each shares features with the next."""
    rng = np.random.default_rng(3)
    parts = rng.integers(0, 256, (count, shared, 128), dtype=np.uint8)
    noise = rng.integers(0, 256, (count, own, 128), dtype=np.uint8)
    return [np.concatenate([parts[k], parts[(k + 1) % count], noise[k]]) for k in range(count)]


def test_all_pairs_are_there_once() -> None:
    found = pairs.all_pairs(NAMES)
    assert len(found) == len(set(found)) == 66
    assert all(one < other for one, other in found)


def test_ordered_photos_are_matched_with_those_near_and_some_far() -> None:
    found = {(NAMES.index(a), NAMES.index(b)) for a, b in pairs.in_order(NAMES, 2, 2)}
    assert {b - a for a, b in found} == {1, 2, 4, 6}


def test_similar_photos_are_matched_and_nothing_else() -> None:
    scores = pairs.similarities(ring(12), QUIET)
    assert np.array_equal(scores, scores.T) and not scores.diagonal().any()
    found = pairs.most_similar(NAMES, scores, 3)
    wanted = {tuple(sorted((NAMES[k], NAMES[(k + 1) % 12]))) for k in range(12)}
    assert set(found) == wanted


def test_merged_pairs_are_there_once_in_either_direction() -> None:
    assert pairs.merged([("b", "a")], [("a", "b"), ("a", "c")]) == [("a", "b"), ("a", "c")]


def test_among_many_photos_only_the_nearest_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    compared = 0
    matches = pairs.matches

    def counting(one: pairs.Unit, other: pairs.Unit) -> int:
        nonlocal compared
        compared += 1
        return matches(one, other)

    monkeypatch.setattr(pairs, "matches", counting)
    monkeypatch.setattr(pairs, "ALL_PAIRS", 10)
    monkeypatch.setattr(pairs, "SHORTLIST", 6)
    count = 40
    scores = pairs.similarities(ring(count), QUIET)
    assert compared <= 6 * count
    neighbours = [scores[k, (k + 1) % count] for k in range(count)]
    assert np.mean(np.array(neighbours) > 0) > 0.9


def test_a_photo_without_features_is_like_none() -> None:
    photos = [*ring(3), np.zeros((0, 128), dtype=np.uint8)]
    assert not pairs.similarities(photos, QUIET)[3].any()
