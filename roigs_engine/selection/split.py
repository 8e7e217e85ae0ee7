"""Splits the photos: test photos, chosen before anything else, and photos for each stage."""

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
    """Choose the test photos; returns their names in scene order (docs/method.md, evaluation).

    For the first box, the views that see it are sorted by the camera's distance to the box's centre
    (names break ties). Every `every`-th view becomes a test photo, starting at `every // 2`, so
    that near and far views are tested. Test photos of earlier boxes count for later boxes. If a
    later box has fewer than ceil(visible / every), the missing ones are taken at equal steps from
    its other views. Every box has at least one test photo and one training photo. With `every` = 0
    there are no test photos.

    Raises:
        ConfigError: `every` is 1 or negative.
        SceneError: too few photos see a box.
    """
    if every == 0:
        return ()
    if every < 2:
        raise ConfigError(
            f"test_every is {every}.", "Use 2 or more; 8 is usual, 0 means no test photos."
        )
    chosen: set[str] = set()
    seen_by: dict[str, list[str]] = {}
    for index, roi in enumerate(rois):
        views = seen_by[roi.name] = _by_distance(scene, roi, context)
        if len(views) < 2:
            raise SceneError(
                f"Only {len(views)} photo sees box '{roi.name}': there must be one to train on and"
                " one to test on.",
                "Check the position of the box, or add photos of the object.",
            )
        if index == 0:
            chosen.update(views[min(every // 2, len(views) // 2) :: every])
            continue
        rest = [name for name in views if name not in chosen]
        missing = math.ceil(len(views) / every) - (len(views) - len(rest))
        count = max(0, min(missing, len(rest)))
        # The middles of `count` equal parts of the list.
        chosen.update(rest[int((k + 0.5) * len(rest) / count)] for k in range(count))
    for name, views in seen_by.items():
        if chosen.issuperset(views):
            raise SceneError(
                f"All {len(views)} photos that see box '{name}' would become test photos.",
                "Use fewer test photos (a larger test_every), or add photos of the object.",
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


def interleaved(orders: Sequence[Sequence[str]]) -> list[str]:
    """Merge selections by rank, each name once, best first."""
    merged: dict[str, None] = {}
    for rank in range(max(map(len, orders), default=0)):
        for order in orders:
            if rank < len(order):
                merged.setdefault(order[rank])
    return list(merged)


def reserved(orders: Sequence[Sequence[str]], kept_share: float) -> set[str]:
    """The selected photos that the Scene-GS must not use (paper, sec. II-B: half of them).

    The Scene-GS may use the share `kept_share` of each selection, evenly over its order. A photo is
    reserved if any box reserves it.
    """
    return {
        name
        for order in orders
        for rank, name in enumerate(order)
        if not in_even_share(rank, kept_share)
    }


def in_even_share(step: int, share: float) -> bool:
    """Whether `step` (from 0) belongs to a share of all steps that is spread evenly."""
    return int((step + 1) * share + 1e-9) > int(step * share + 1e-9)
