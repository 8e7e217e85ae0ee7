"""Which photos are matched with which."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from .database import Pair

FEW = 30  # photos up to which all pairs are matched
OVERLAP = 5  # photos before and after, in the order of names
LOOPS = 5  # most similar photos that ordered photos are matched with too
JUMPS = 5  # farther ones: 2, 4, 8, ... photos ahead, for ordered photos


def all_pairs(names: Sequence[str]) -> list[Pair]:
    """Every pair."""
    return [(one, other) for row, one in enumerate(names) for other in names[row + 1 :]]


def in_order(names: Sequence[str], overlap: int = OVERLAP, jumps: int = 0) -> list[Pair]:
    """Photos that follow one another, at most `overlap` apart, or 2, 4, 8, ... (`jumps` of these).

    Args:
        names: sorted.
        overlap, jumps: see above.
    """
    steps = sorted({*range(1, overlap + 1), *(overlap + 2**power for power in range(1, jumps + 1))})
    return [(names[row], names[row + k]) for k in steps for row in range(len(names) - k)]


def most_similar(names: Sequence[str], scores: NDArray[np.float32], count: int) -> list[Pair]:
    """Each photo with the `count` most similar ones; pairs that have nothing alike are left out."""
    chosen: set[Pair] = set()
    for row, one in enumerate(names):
        nearest = np.argsort(-scores[row], kind="stable")[:count]
        chosen |= {_ordered(one, names[k]) for k in nearest if k != row and scores[row, k] > 0}
    return sorted(chosen)


def merged(*parts: Iterable[Pair]) -> list[Pair]:
    """The pairs of all parts, each once, the first part first."""
    return list(dict.fromkeys(_ordered(*pair) for part in parts for pair in part))


def _ordered(one: str, other: str) -> Pair:
    return (one, other) if one < other else (other, one)
