"""`greedy`: exact greedy maximisation of density x occupancy, without a surrogate.

Also has the lazy greedy loop (Minoux 1978), which `coverage` shares. For a submodular function, an
earlier gain is an upper bound of the current one. So only the photo on top of the heap is measured
again. f = D O is not submodular. log f is, and has the same argmax, so the heap uses its gains.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable

import numpy as np

from ..context import Context
from .baselines import fill_up
from .request import Picks, Request
from .score import DensityOccupancy


def lazy_greedy(
    views: list[int],
    gain: Callable[[int], float],
    add: Callable[[int], None],
    count: int,
    context: Context,
) -> list[int]:
    """Choose up to `count` views, each with the largest gain after those before it.

    View ids break ties. There are fewer views if no remaining one has a gain. `gain` of a view for
    the current set must not grow as the set grows; `add` adds a view to the set.
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


def order_greedy(request: Request) -> Picks:
    """Order photos greedily: each increases density x occupancy most; farthest views follow."""
    score = DensityOccupancy(request.candidates)
    # log f of the empty set is -Inf: the first photo is picked outside the lazy loop.
    first = int(np.argmax(score.gains()))
    score.add(first)
    if not score.product:
        return fill_up(request, [first], score)
    others = [view for view in range(len(request.candidates)) if view != first]

    def log_gain(view: int) -> float:
        return math.log(score.product_with(view)) - math.log(score.product)

    count, context = request.count - 1, request.context
    order = [first, *lazy_greedy(others, log_gain, score.add, count, context)]
    return fill_up(request, order, score)
