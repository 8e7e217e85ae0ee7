"""`fvs` and `random`: baselines; farthest view sampling also completes saturated selections."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..model.scene import Float64
from ..model.visibility import Candidates
from .result import Picks

# Weight of log distance against the unit direction: a factor of 2 in distance counts as much as an
# angle of about 10 degrees.
LOG_DISTANCE_WEIGHT = 0.25
# Lower limit of the distance, in box diagonals.
MIN_DISTANCE_SHARE = 1e-3


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
    """`start` extended to `count` photos; each next one is farthest from all before it.

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


def order_fvs(candidates: Candidates, count: int) -> Picks:
    """Farthest view sampling, from the photo that sees most points of the box."""
    start = [most_keypoints(candidates)]
    return Picks(order=tuple(farthest_first(view_positions(candidates), start, count)))


def order_random(candidates: Candidates, count: int, seed: int) -> Picks:
    """A seeded random order."""
    order = np.random.default_rng(seed).permutation(len(candidates))
    return Picks(order=tuple(order[:count].tolist()))


def fill_up(
    candidates: Candidates, order: Sequence[int], count: int, flags: tuple[str, ...] = ()
) -> Picks:
    """The first `count` photos of `order`, extended with farthest views if it is shorter.

    For methods that maximise a score, when no photo improves the score any more.
    """
    if len(order) >= count:
        return Picks(order=tuple(order[:count]), flags=flags)
    start = list(order) or [most_keypoints(candidates)]
    full = farthest_first(view_positions(candidates), start, count)
    return Picks(order=tuple(full), filled_from=len(order), flags=flags)
