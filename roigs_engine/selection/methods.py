"""Registry of the selection methods: name -> functions that order and score photos.

The methods are in `gp` (Gaussian process, the paper's methods), `greedy` (the same score without a
surrogate), `coverage` (facility location over points and directions) and `baselines` (ranks of
static features, farthest views, random). A new one is one file, and one line in `METHODS`: its name
for the user, and a function that returns `Picks`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ..context import Context
from ..model.visibility import Candidates
from .baselines import order_fvs, order_random, order_static
from .coverage import Coverage, order_coverage
from .gp import order_gp
from .greedy import order_greedy
from .request import Picks, Request
from .score import DensityOccupancy, Score


@dataclass(frozen=True)
class Method:
    """A method: orders photos, best first, and scores a set of them."""

    order: Callable[[Request], Picks]
    score: Callable[[Candidates, Context], Score] = DensityOccupancy


METHODS = {
    "static": Method(order_static),
    "gp6": Method(partial(order_gp, extended=False)),
    "gp9": Method(partial(order_gp, extended=True)),
    "greedy": Method(order_greedy),
    "coverage": Method(order_coverage, score=Coverage),
    "fvs": Method(order_fvs),
    "random": Method(order_random),
}
