"""Which photos are held out for testing, chosen before anything else looks at the scene."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError, SceneError
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from . import visible_images


def choose_test_views(
    scene: SfmScene, rois: Sequence[OrientedBox], every: int = 8, context: Context = QUIET
) -> tuple[str, ...]:
    """Names of the held-out photos, in the scene's order (docs/method.md, evaluation).

    The views that see a box are sorted by the camera's distance to the box's centre (ties by name);
    every `every`-th of them is taken, starting at `every // 2`, so that near and far are both
    tested. For the second and later boxes the views already taken count: only when fewer than
    ceil(visible / every) of its views are tested, the missing ones are taken at equal steps from
    the rest. Every box is left with at least one photo to train on and has at least one to test on.
    With `every` = 0 none is held out.

    Raises:
        ConfigError: `every` is 1 or negative.
        SceneError: a box is seen by too few photos to hold one out.
    """
    if every == 0:
        return ()
    if every < 2:
        raise ConfigError(
            f"test_every is {every}.", "Hold out every 2nd photo at most; 8 is usual, 0 for none."
        )
    chosen: set[str] = set()
    seen_by: dict[str, list[str]] = {}
    for index, roi in enumerate(rois):
        views = seen_by[roi.name] = _by_distance(scene, roi, context)
        if len(views) < 2:
            raise SceneError(
                f"Box '{roi.name}' is seen by {len(views)} photo(s): none can be held out.",
                "Check where the box is, or add photos of the object.",
            )
        if index == 0:
            chosen.update(views[min(every // 2, len(views) // 2) :: every])
            continue
        rest = [name for name in views if name not in chosen]
        missing = math.ceil(len(views) / every) - (len(views) - len(rest))
        chosen.update(_at_equal_steps(rest, missing))
    for name, views in seen_by.items():
        if chosen.issuperset(views):
            raise SceneError(
                f"All {len(views)} photos that see box '{name}' would be held out for testing.",
                "Hold out fewer photos (a larger test_every), or add photos of the object.",
            )
    return tuple(image.name for image in scene.images if image.name in chosen)


def _by_distance(scene: SfmScene, roi: OrientedBox, context: Context) -> list[str]:
    """Names of the views that see the box, nearest camera first."""
    visible = set(visible_images(scene, roi, context))
    distance = {
        image.name: float(np.linalg.norm(image.centre - roi.centre))
        for image in scene.images
        if image.name in visible
    }
    return sorted(distance, key=lambda name: (distance[name], name))


def _at_equal_steps(names: list[str], count: int) -> list[str]:
    """`count` of the names, from the middles of `count` equal parts of the list."""
    count = max(0, min(count, len(names)))
    return [names[int((k + 0.5) * len(names) / count)] for k in range(count)]
