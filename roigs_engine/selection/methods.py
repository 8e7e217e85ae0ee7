"""Registry of the selection methods: name -> how photos are ordered and scored.

Each method has its own file: `static` (ranks of static features), `gp` (Gaussian process, the
paper's methods), `greedy` (the same score without a surrogate), `coverage` (facility location over
points and directions), `baselines` (farthest views, random). A new one is one file, and one line in
`METHODS`: its name for the user, and a function that returns `Picks`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..context import Context
from ..model.visibility import Candidates
from .baselines import order_fvs, order_random
from .coverage import order_coverage, prefix_coverage
from .gp import order_gp
from .greedy import order_greedy
from .result import Picks
from .score import prefix_scores
from .static import StaticFeatures, order_static


@dataclass(frozen=True, kw_only=True, eq=False)
class Request:
    """What a method gets.

    Attributes:
        candidates: the photos that see the box.
        features: of the candidates.
        count: how many to pick, at most all.
        seed: of everything random.
    """

    candidates: Candidates
    features: StaticFeatures
    count: int
    seed: int
    context: Context


@dataclass(frozen=True)
class Method:
    """How a method orders photos, best first, and the score of each prefix of an order."""

    order: Callable[[Request], Picks]
    score: Callable[[Candidates, tuple[int, ...], Context], tuple[float, ...]] = prefix_scores


METHODS: dict[str, Method] = {
    "static": Method(lambda r: order_static(r.features, r.count)),
    "gp6": Method(lambda r: _gp(r, extended=False)),
    "gp9": Method(lambda r: _gp(r, extended=True)),
    "greedy": Method(lambda r: order_greedy(r.candidates, r.count, r.context)),
    "coverage": Method(
        lambda r: order_coverage(r.candidates, r.count, r.context), score=prefix_coverage
    ),
    "fvs": Method(lambda r: order_fvs(r.candidates, r.count)),
    "random": Method(lambda r: order_random(r.candidates, r.count, r.seed)),
}


def _gp(request: Request, *, extended: bool) -> Picks:
    return order_gp(
        request.candidates,
        request.features,
        request.count,
        extended=extended,
        seed=request.seed,
        context=request.context,
    )
