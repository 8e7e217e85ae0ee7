"""Selects the photos that train an object (the paper's sec. III-A).

`select_cameras` is the entry point; `METHODS` names the methods. The same scene, box and settings
always give the same photos in the same order: photos are processed in name order, names break ties,
and all random choices have a seed. Nothing here needs torch.
"""

from __future__ import annotations

from ..context import QUIET, Context
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..model.scene_checks import FEW, few_photos, kind_of_photos
from ..model.visibility import find_candidates, observations, visible_images
from .config import SelectionConfig
from .methods import METHODS
from .request import Request, static_features
from .result import CameraSelection, format_selection
from .score import prefix_values

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
        config: method and settings.
        tests: the model with its test photos only; a warning about few photos counts them.

    Raises:
        RoiError: no point lies in the box, or no photo sees its points.
    """
    candidates = find_candidates(scene, roi, context)
    features = static_features(candidates, context)
    scored = candidates.thinned()
    method = METHODS[config.method]
    picks = method.order(
        Request(
            candidates=scored,
            features=features,
            count=config.resolved_count(len(candidates)),
            seed=config.seed,
            context=context,
        )
    )
    flags = (
        *candidates.flags,
        *features.flags(candidates),
        *_count_flags(roi, config, len(candidates), tests, context),
        *picks.flags,
    )
    for flag in flags:
        context.warn(flag)
    names = candidates.names
    return CameraSelection(
        roi=roi.name,
        method=config.method,
        names=tuple(names[view] for view in picks.order),
        scores=prefix_values(picks.score or method.score(scored, context), picks.order),
        candidates=names,
        flags=flags,
        features=features.to_dict(candidates),
    )


def _count_flags(
    roi: OrientedBox,
    config: SelectionConfig,
    candidates: int,
    tests: SfmScene | None,
    context: Context,
) -> tuple[str, ...]:
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
