"""From the photos with strokes to all photos, and back until the photos agree."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from ..context import QUIET, Context
from ..formats.events import StageStarted
from ..model.scene import Float64
from .grab_cut import Prior, cut, fenced
from .views import Mask, View

STAGE = "masks"
FIRST_BAND, WIDE_BAND, BAND = 0.5, 0.08, 0.04  # see `cut`: strokes alone; on the way; at the end
PERSON = 3.0  # weight of a mask that a person has made or scribbled on
AGREEMENTS = 1  # rounds in which all photos vote on each


class Knowledge(Protocol):
    """What photos have said of the things in the box, and what that means in other photos."""

    def learn_strokes(self, view: View) -> None:
        """Count what the strokes on a photo say; other pixels say nothing."""

    def learn(self, view: View, mask: Mask, weight: float = 1.0) -> None:
        """Count a photo's mask, in place of what the photo has said before."""

    def prior(self, view: View, *, without: bool = True) -> Prior:
        """What the photos say of this one; `without`: without its own votes."""


def make_masks(
    views: Sequence[View], knowledge: Knowledge, centre: Float64, context: Context = QUIET
) -> dict[str, Mask]:
    """The object's masks in all photos, by their names, at the sizes of the views.

    Masks that are kept help to make the others, and stay.

    Args:
        views: photos that show the box; at least one with strokes or a mask.
        knowledge: what carries masks from photo to photo; nothing is learnt yet.
        centre: (3,) of the box.
        context: gets the progress; checked for cancellation.
    """
    steps = _Steps(len(views) * (1 + AGREEMENTS), context)
    masks: dict[str, Mask] = {}
    begun = _begun(views)
    for view in views:
        if view.given is None and view.is_scribbled:
            knowledge.learn_strokes(view)
    for view in begun:
        mask = view.known
        if mask is None:
            mask = cut(view, knowledge.prior(view, without=False), FIRST_BAND)
        masks[view.name] = mask
        steps.done()
    for view in begun:
        knowledge.learn(view, masks[view.name], PERSON)
    for view in views:
        if view.kept is not None and view not in begun:
            masks[view.name] = view.kept
            knowledge.learn(view, view.kept)
            steps.done()
    for view in _nearest_first(views, [view for view in views if view.name in masks], centre):
        masks[view.name] = cut(view, knowledge.prior(view), WIDE_BAND)
        knowledge.learn(view, masks[view.name])
        steps.done()
    for _ in range(AGREEMENTS):
        for view in views:
            if view.known is None:
                masks[view.name] = cut(view, knowledge.prior(view), BAND)
            steps.done()
        for view in views:
            knowledge.learn(view, masks[view.name], PERSON if view in begun else 1.0)
    return masks


def _begun(views: Sequence[View]) -> list[View]:
    """The photos to begin with: a person's masks, and objects with strokes all around them.

    Other strokes correct a mask: they are too few to begin with, unless there is nothing else.
    """
    whole = [view for view in views if view.given is not None or fenced(view).any()]
    return whole or [view for view in views if view.is_scribbled]


class _Steps:
    """Progress of the work, in photos."""

    def __init__(self, total: int, context: Context) -> None:
        self._context, self._total, self._step = context, total, 0
        self._started = time.monotonic()
        context.emit(StageStarted(stage=STAGE, total=total))

    def done(self) -> None:
        """One more photo; raises Stopped on request."""
        self._context.check_cancelled()
        self._step += 1
        self._context.progress(STAGE, self._step, self._total, self._started)


def _nearest_first(views: Sequence[View], begun: Sequence[View], centre: Float64) -> list[View]:
    """The other photos, each the nearest to any before it, seen from the box."""
    distance = _distances(centre)
    left = [view for view in views if view not in begun]
    away = {view.name: min(distance(view, one) for one in begun) for view in left}
    order = []
    while left:
        view = min(left, key=lambda view: away[view.name])
        left.remove(view)
        order.append(view)
        for other in left:
            away[other.name] = min(away[other.name], distance(other, view))
    return order


def _distances(centre: Float64) -> Callable[[View, View], float]:
    """How different two photos show the box: an angle, and the ratio of their distances."""

    def distance(a: View, b: View) -> float:
        x, y = a.centre - centre, b.centre - centre
        far, near = float(np.linalg.norm(x)) + 1e-12, float(np.linalg.norm(y)) + 1e-12
        angle = float(np.arccos(np.clip(x @ y / (far * near), -1, 1)))
        return angle + 0.3 * abs(float(np.log(far / near)))

    return distance
