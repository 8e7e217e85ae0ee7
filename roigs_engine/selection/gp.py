"""`gp6`, `gp9`: selection by a Gaussian process over viewpoints (the paper's sec. III-A).

After ActiveInitSplat (arXiv 2503.06859): from a photo's viewpoint, a GP predicts its gain in the
score f (score.py). The photo with the best upper confidence bound is picked, its true gain is
measured, and the GP is fitted again. The inputs of `gp6` are position and viewing direction; `gp9`
adds the three static features.

To limit the cost, hyper-parameters are optimised only at the start and every `REFIT_EVERY` picks.
In between, only the new gain is added. 150 picks of 314 photos take seconds on one core.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from ..model.scene import Float64
from ..model.visibility import Candidates
from .baselines import farthest_first, fill_up, most_keypoints
from .request import Picks, Request, StaticFeatures
from .score import DensityOccupancy

SEEDS = 5  # photos picked before the first fit
BETA = 2.0  # weight of the standard deviation in the upper confidence bound
REFIT_EVERY = 10  # picks between two optimisations of the hyper-parameters
RESTARTS = 1
# A feature is constant if its standard deviation is below this share of max(1, its largest value).
CONSTANT = 1e-9

FEATURE_NAMES = (
    *("position x", "position y", "position z"),
    *("direction x", "direction y", "direction z"),
    *("log distance", "log area", "log keypoints"),
)


def gp_inputs(
    candidates: Candidates, features: StaticFeatures, extended: bool
) -> tuple[Float64, tuple[str, ...]]:
    """(V, D) z-scored inputs, and the names of the D <= 6 (9 if `extended`) features that vary.

    Position is in the box's frame, in half extents. Direction is the unit forward vector in the
    box's frame, because angles wrap around.
    """
    roi = candidates.roi
    rotation = roi.world_to_box[:3, :3]
    columns = [roi.to_box(candidates.centres()), candidates.forwards() @ rotation.T]
    if extended:
        distance = np.maximum(features.distance, 1e-9 * roi.diagonal)
        logs = np.log(distance), np.log(features.area + 1e-6), np.log1p(features.keypoints)
        columns.append(np.column_stack(logs))
    table = np.concatenate(columns, axis=1)
    deviation = table.std(axis=0)
    varies = deviation > CONSTANT * np.maximum(1.0, np.abs(table).max(axis=0))
    names = tuple(n for n, kept in zip(FEATURE_NAMES, varies, strict=False) if kept)
    return (table[:, varies] - table[:, varies].mean(axis=0)) / deviation[varies], names


class Surrogate:
    """A GP from viewpoints to gains; keeps its hyper-parameters between optimisations."""

    def __init__(self, inputs: Float64, seed: int) -> None:
        # scikit-learn takes a second to import
        from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

        self._inputs = inputs
        self._seed = seed
        self._kernel: Any = ConstantKernel(1.0, (1e-2, 1e2)) * Matern(
            length_scale=np.ones(inputs.shape[1]), length_scale_bounds=(1e-1, 1e2), nu=2.5
        ) + WhiteKernel(1e-2, (1e-6, 1.0))
        self._model: Any = None

    def fit(self, views: list[int], gains: Float64, optimise: bool) -> None:
        """Fit the (n,) gains of these photos; `optimise` the hyper-parameters or keep them."""
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.gaussian_process import GaussianProcessRegressor

        self._model = GaussianProcessRegressor(
            kernel=self._kernel,
            optimizer="fmin_l_bfgs_b" if optimise else None,
            n_restarts_optimizer=RESTARTS if optimise else 0,
            normalize_y=True,
            random_state=self._seed,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            self._model.fit(self._inputs[views], gains)
        self._kernel = self._model.kernel_

    def predict(self, views: list[int]) -> tuple[Float64, Float64]:
        """(n,) means and (n,) standard deviations of the gains of these photos."""
        with warnings.catch_warnings():
            # scikit-learn warns when it sets a slightly negative variance to zero.
            warnings.simplefilter("ignore", UserWarning)
            mean, deviation = self._model.predict(self._inputs[views], return_std=True)
        return np.nan_to_num(mean), np.nan_to_num(deviation)


def order_gp(request: Request, *, extended: bool) -> Picks:
    """Pick photos by the best upper confidence bound, one at a time.

    Starts with the photo that sees most points and those with the most different viewing
    directions. Continues with farthest views once no remaining photo improves the score.
    """
    candidates, count = request.candidates, request.count
    inputs, names = gp_inputs(candidates, request.features, extended)
    possible = FEATURE_NAMES[: 9 if extended else 6]
    dropped = [name for name in possible if name not in names]
    flags: tuple[str, ...] = ()
    if dropped and len(candidates) > 1:
        flags = (f"The GP ignores features that are equal for all photos: {', '.join(dropped)}.",)
    score = DensityOccupancy(candidates)
    seeds = farthest_first(
        candidates.forwards(), [most_keypoints(candidates)], min(SEEDS, count, len(candidates))
    )
    gains = []
    for view in seeds:
        gains.append(float(score.gains()[view]))
        score.add(view)
    if not names:
        return fill_up(request, seeds, score, flags)
    order = _loop(Surrogate(inputs, request.seed), score, seeds, gains, request)
    return fill_up(request, order, score, flags)


def _loop(
    surrogate: Surrogate,
    score: DensityOccupancy,
    seeds: list[int],
    gains: list[float],
    request: Request,
) -> list[int]:
    """Extend `seeds` until there are enough photos, or all remaining gains are zero."""
    order = list(seeds)
    while len(order) < request.count:
        request.context.check_cancelled()
        present = score.gains()
        taken = set(order)
        rest = [view for view in range(len(present)) if view not in taken]
        if not (present[rest] > 0).any():
            break
        optimise = (len(order) - len(seeds)) % REFIT_EVERY == 0
        surrogate.fit(order, np.array(gains), optimise)
        mean, deviation = surrogate.predict(rest)
        bound = mean + BETA * deviation
        # Largest upper confidence bound; ties: larger deviation first, then the name.
        view = rest[int(np.lexsort((-deviation, -bound))[0])]
        gains.append(float(present[view]))
        score.add(view)
        order.append(view)
    return order
