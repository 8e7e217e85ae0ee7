"""`greedy`: exact greedy maximisation of density x occupancy, without a surrogate.

Also the lazy greedy loop (Minoux 1978) that `coverage` shares: a gain measured earlier is an upper
bound of the present one when the function is submodular, so only the photo on top of the heap is
measured again. f = D O is not submodular; log f is, and has the same argmax, so its gains drive
the heap.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable

import numpy as np

from ..context import QUIET, Context
from ..model.visibility import Candidates
from .baselines import fill_up
from .records import Picks
from .score import DensityOccupancy


def lazy_greedy(
    views: list[int],
    gain: Callable[[int], float],
    add: Callable[[int], None],
    count: int,
    context: Context = QUIET,
) -> list[int]:
    """Up to `count` views, each with the largest gain given those before it; ties by view id.

    Args:
        views: the views to choose from.
        gain: what a view adds to the present set; must not grow as the set grows.
        add: puts a view into the set.
        count: how many at most; fewer come back when no remaining view adds anything.
    """
    heap = [(-gain(view), view, 0) for view in views]
    heapq.heapify(heap)
    order: list[int] = []
    while heap and len(order) < count:
        context.check_cancelled()
        negative, view, measured_at = heapq.heappop(heap)
        if measured_at < len(order):
            heapq.heappush(heap, (-gain(view), view, len(order)))
        elif negative >= 0:
            break
        else:
            add(view)
            order.append(view)
    return order


def order_greedy(candidates: Candidates, count: int, context: Context = QUIET) -> Picks:
    """The photos that raise density x occupancy most, one at a time; then farthest views."""
    score = DensityOccupancy(candidates)
    # log f of the empty set is -inf: the first pick is made outside the lazy loop.
    first = int(np.argmax(score.gains()))
    score.add(first)
    others = [view for view in range(len(candidates)) if view != first]

    def log_gain(view: int) -> float:
        return math.log(score.product_with(view)) - math.log(score.product)

    order = [first, *lazy_greedy(others, log_gain, score.add, count - 1, context)]
    return fill_up(candidates, order, count)
