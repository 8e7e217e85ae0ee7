"""Selects the photos that an object is trained on (the paper's sec. III-A).

`select_cameras` is the only entry point. Each method has its own file: `static` (ranks of static
features), `gp6` and `gp9` (Gaussian process, the paper's methods), `greedy` (the same score without
a surrogate), `coverage` (facility location over points and directions), `fvs` and `random`
(baselines).

The same scene, box and settings always give the same photos in the same order: photos are processed
in name order, names break ties, and everything random has a seed. Nothing here needs torch.
"""

from __future__ import annotations

from ..context import QUIET, Context
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..model.scene_checks import FEW, few_photos, kind_of_photos
from ..model.visibility import Candidates, find_candidates, observations, visible_images
from .baselines import order_fvs, order_random
from .config import METHODS, SelectionConfig
from .coverage import order_coverage, prefix_coverage
from .features import StaticFeatures, static_features
from .greedy import order_greedy
from .records import CameraSelection, Picks
from .report import format_selection
from .score import prefix_scores
from .static import order_static

__all__ = [
    "METHODS",
    "CameraSelection",
    "SelectionConfig",
    "format_selection",
    "select_cameras",
    "visible_images",
]


def select_cameras(
    scene: SfmScene,
    roi: OrientedBox,
    config: SelectionConfig,
    context: Context = QUIET,
    *,
    tests: SfmScene | None = None,
) -> CameraSelection:
    """Select the photos of a box, best first.

    Args:
        scene: the model without its test photos (`SfmScene.without`).
        roi: the box.
        config: method and settings.
        context: receives a warning for each degenerate case; checked for cancellation.
        tests: the model with its test photos only; a warning about few photos counts them.

    Raises:
        RoiError: no point lies in the box, or no photo sees one that does.
    """
    candidates = find_candidates(scene, roi, context)
    features = static_features(candidates, context)
    count = config.resolved_count(len(candidates))
    picks = _order(candidates, features, config, count, context)
    if config.method == "coverage":
        scores = prefix_coverage(candidates, picks.order, context)
    else:
        scores = prefix_scores(candidates, picks.order)
    flags = (
        *candidates.flags,
        *features.flags(candidates),
        *_count_flags(roi, config, len(candidates), tests, context),
        *_picks_flags(picks),
    )
    for flag in flags:
        context.warn(flag)
    names = candidates.names
    return CameraSelection(
        roi=roi.name,
        method=config.method,
        names=tuple(names[view] for view in picks.order),
        scores=scores,
        candidates=names,
        flags=flags,
        features=features.to_dict(candidates),
    )


def _order(
    candidates: Candidates,
    features: StaticFeatures,
    config: SelectionConfig,
    count: int,
    context: Context,
) -> Picks:
    """Run the configured method."""
    match config.method:
        case "static":
            return order_static(features, count)
        case "gp6" | "gp9":
            from .gp import order_gp  # scikit-learn takes a second to import

            return order_gp(
                candidates,
                features,
                count,
                extended=config.method == "gp9",
                seed=config.seed,
                context=context,
            )
        case "greedy":
            return order_greedy(candidates, count, context)
        case "coverage":
            return order_coverage(candidates, count, context)
        case "fvs":
            return order_fvs(candidates, count)
        case "random":
            return order_random(candidates, count, config.seed)
        case _:
            raise AssertionError(f"`METHODS` has {config.method}, but nothing orders by it.")


def _count_flags(
    roi: OrientedBox,
    config: SelectionConfig,
    candidates: int,
    tests: SfmScene | None,
    context: Context,
) -> tuple[str, ...]:
    """Warnings about too few candidates."""
    if candidates >= FEW and (config.count is None or candidates >= config.count):
        return ()
    testing = 0 if tests is None else len(observations(tests, roi, context))
    few = few_photos(roi.name, candidates, tests=testing)
    if few:
        return tuple(few)
    kind, others = kind_of_photos(candidates, testing)
    return (
        f"Only {candidates} {kind}s see box '{roi.name}'{others}, fewer than the {config.count}"
        " requested: all are used.",
    )


def _picks_flags(picks: Picks) -> tuple[str, ...]:
    """The method's own warnings, and one if its score saturated."""
    if picks.filled_from is None:
        return picks.flags
    return (
        *picks.flags,
        f"No photo after the first {picks.filled_from} improved the score: the remaining"
        f" {len(picks.order) - picks.filled_from} are the views farthest from those selected.",
    )
