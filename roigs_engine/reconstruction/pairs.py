"""Chooses the pairs of photos to match: in order, or by a cheap measure of similarity.

Features of large scales are few and match most often. So a few hundred of them show whether it is
worth matching all features (preemptive matching, Wu 2013). With very many photos, even these are
compared only with the most similar photos, found by an aggregate of all features of a photo (VLAD,
Jégou et al. 2010, with words from the photos themselves).
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..context import Context
from ..formats.events import StageStarted
from .database import Pair

FEW = 30  # photos up to which all pairs are matched
OVERLAP = 5  # photos before and after, in the order of names
LOOPS = 5  # similar photos that each ordered photo is also matched with
JUMPS = 5  # farther photos of an ordered one's pairs: `OVERLAP` + 2, 4, 8, ... photos ahead


def all_pairs(names: Sequence[str]) -> list[Pair]:
    """All pairs of photos."""
    return [(one, other) for row, one in enumerate(names) for other in names[row + 1 :]]


def in_order(names: Sequence[str], overlap: int = OVERLAP, jumps: int = 0) -> list[Pair]:
    """Pairs of photos at most `overlap` apart, and `jumps` farther ones.

    The farther ones are `overlap` + 2, 4, 8, ... apart. `names` are sorted.
    """
    steps = sorted({*range(1, overlap + 1), *(overlap + 2**power for power in range(1, jumps + 1))})
    return [(names[row], names[row + k]) for k in steps for row in range(len(names) - k)]


def most_similar(names: Sequence[str], scores: NDArray[np.float32], count: int) -> list[Pair]:
    """Pair each photo with the `count` most similar ones, except those with a score of 0."""
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


STAGE = "compare photos"
LARGEST = 600  # features of a photo to compare
MAX_RATIO, MAX_ANGLE = 0.8, 0.7  # COLMAP's limits for the angles between matching descriptors
ALL_PAIRS = 300  # photos up to which every pair is compared
SHORTLIST = 100  # above `ALL_PAIRS`, each photo is compared with this many
WORDS, SAMPLE = 64, 100_000

Descriptors = NDArray[np.uint8]
Unit = NDArray[np.float32]


def similarities(
    photos: Sequence[Descriptors], context: Context, seed: int = 0
) -> NDArray[np.float32]:
    """(N, N) symmetric numbers of matches between photos' largest features; 0: not compared.

    `photos`: (M, 128) descriptors of each; `seed`: for the words.
    """
    total = len(photos)
    found = np.zeros((total, total), dtype=np.float32)
    wanted = _shortlisted(photos, seed) if total > ALL_PAIRS else ~np.eye(total, dtype=bool)
    wanted = np.triu(wanted | wanted.T, 1)
    context.emit(StageStarted(stage=STAGE, total=total))
    started = time.monotonic()
    units = [unit(photo) for photo in photos]
    for row in range(total):
        context.check_cancelled()
        for column in map(int, np.flatnonzero(wanted[row])):
            found[row, column] = found[column, row] = matches(units[row], units[column])
        context.progress(STAGE, row + 1, total, started)
    return found


def unit(descriptors: Descriptors) -> Unit:
    """Convert descriptors to unit vectors."""
    values = descriptors.astype(np.float32)
    values /= np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-6)
    return values


def matches(one: Unit, other: Unit) -> int:
    """The number of features that are each other's nearest, by COLMAP's limits."""
    if len(one) < 2 or len(other) < 2:
        return 0
    cosines = _product()(one, other)
    rows = np.arange(len(one))
    nearest = cosines.argmax(axis=1)
    best = cosines[rows, nearest]
    mutual = cosines.max(axis=0)[nearest] == best
    cosines[rows, nearest] = -1
    angle, second = (np.arccos(np.clip(c, -1, 1)) for c in (best, cosines.max(axis=1)))
    return int((mutual & (angle < MAX_RATIO * second) & (angle < MAX_ANGLE)).sum())


@functools.cache
def _product() -> Callable[[Unit, Unit], Unit]:
    """The function (N, K), (M, K) -> (N, M) products: torch's if installed, for speed."""
    try:
        import torch
    except ImportError:
        return lambda one, other: np.asarray(one @ other.T)
    return lambda one, other: torch.mm(torch.from_numpy(one), torch.from_numpy(other).T).numpy()


def _shortlisted(photos: Sequence[Descriptors], seed: int) -> NDArray[np.bool_]:
    """(N, N) whether a photo is among the most similar ones of another, by VLAD vectors."""
    from sklearn.cluster import MiniBatchKMeans

    rng = np.random.default_rng(seed)
    each = max(1, SAMPLE // len(photos))
    sample = [unit(p)[rng.permutation(len(p))[:each]] for p in photos if len(p)]
    words = MiniBatchKMeans(WORDS, n_init=1, random_state=seed).fit(np.concatenate(sample))
    centres = words.cluster_centers_.astype(np.float32)
    vectors = np.array([_aggregate(unit(photo), centres) for photo in photos])
    near = vectors @ vectors.T
    np.fill_diagonal(near, -np.inf)
    rank = np.argsort(-near, axis=1)[:, :SHORTLIST]
    chosen = np.zeros(near.shape, dtype=bool)
    np.put_along_axis(chosen, rank, True, axis=1)
    return chosen


def _aggregate(features: Unit, centres: Unit) -> Unit:
    """The photo's VLAD vector: differences to the nearest words, summed and normalised."""
    sums = np.zeros_like(centres)
    if len(features):
        nearest = (features @ centres.T - 0.5 * (centres**2).sum(axis=1)).argmax(axis=1)
        np.add.at(sums, nearest, features - centres[nearest])
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-6)
    flat = sums.ravel()
    return np.asarray(flat / max(float(np.linalg.norm(flat)), 1e-6), dtype=np.float32)
