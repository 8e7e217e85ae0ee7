"""The baselines `static`, `fvs` and `random`; farthest views also fill up saturated selections."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..model.scene import Float64
from ..model.visibility import Candidates
from .request import Picks, Request
from .score import Score

# Weight of log distance against the unit direction: a factor of 2 in distance counts as much as an
# angle of about 10 degrees.
LOG_DISTANCE_WEIGHT = 0.25
MIN_DISTANCE_SHARE = 1e-3  # lower limit of the distance, in box diagonals


def view_positions(candidates: Candidates) -> Float64:
    """(V, 4) position of each photo relative to the box: unit direction, weighted log distance."""
    offset = candidates.centres() - candidates.roi.centre
    distance = np.linalg.norm(offset, axis=1)
    distance = np.maximum(distance, MIN_DISTANCE_SHARE * candidates.roi.diagonal)
    return np.column_stack([offset / distance[:, None], LOG_DISTANCE_WEIGHT * np.log(distance)])


def most_keypoints(candidates: Candidates) -> int:
    """The photo that sees most points of the box; the name breaks ties."""
    return int(np.argmax(np.bincount(candidates.obs_view, minlength=len(candidates))))


def farthest_first(positions: Float64, start: Sequence[int], count: int) -> list[int]:
    """Extend `start` to `count` photos; each next one is farthest from all before it.

    The name breaks ties. `positions`: (V, D) one row per candidate; `start`: at least one of them.
    """
    order = list(start[:count])
    nearest = np.full(len(positions), np.inf)
    for view in order:
        nearest = np.minimum(nearest, np.linalg.norm(positions - positions[view], axis=1))
    taken = np.zeros(len(positions), dtype=bool)
    taken[order] = True
    while len(order) < count:
        view = int(np.argmax(np.where(taken, -1.0, nearest)))
        order.append(view)
        taken[view] = True
        nearest = np.minimum(nearest, np.linalg.norm(positions - positions[view], axis=1))
    return order


def order_static(request: Request) -> Picks:
    """Order photos by the sum of ranks of -distance, area and keypoints (paper, ablation 3).

    Equal values share their mean rank; names break ties (candidates are in name order).
    """
    of = request.features
    ranks = _ranks(of.distance) + _ranks(-of.area) + _ranks(-of.keypoints)
    return Picks(order=tuple(np.argsort(ranks, kind="stable")[: request.count].tolist()))


def _ranks(values: Float64) -> Float64:
    """(V,) -> (V,) ranks from 1, ascending; equal values share their mean rank."""
    _, index, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - (counts - 1) / 2)[index])


def order_fvs(request: Request) -> Picks:
    """Order photos by farthest view sampling, from the photo that sees most points of the box."""
    candidates = request.candidates
    start = [most_keypoints(candidates)]
    positions = view_positions(candidates)
    return Picks(order=tuple(farthest_first(positions, start, request.count)))


def order_random(request: Request) -> Picks:
    """Order photos at random, with a seed."""
    order = np.random.default_rng(request.seed).permutation(len(request.candidates))
    return Picks(order=tuple(order[: request.count].tolist()))


def fill_up(
    request: Request, order: Sequence[int], score: Score, flags: tuple[str, ...] = ()
) -> Picks:
    """Take the first photos of `order`; if it is too short, add farthest views.

    For methods that maximise a score, once no photo improves the score.
    """
    score.clear()
    candidates, count = request.candidates, request.count
    if len(order) >= count:
        return Picks(order=tuple(order[:count]), flags=flags, score=score)
    start = list(order) or [most_keypoints(candidates)]
    full = farthest_first(view_positions(candidates), start, count)
    text = (
        f"No photo after the first {len(order)} improved the score: the remaining"
        f" {count - len(order)} are the views farthest from those selected."
    )
    return Picks(order=tuple(full), flags=(*flags, text), score=score)
