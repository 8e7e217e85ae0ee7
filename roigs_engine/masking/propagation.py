"""Propagates an object's masks from photos with strokes to all photos, so that they agree.

In each photo, GrabCut (Rother et al. 2004, OpenCV's) cuts the object out, using the votes of the
other photos (docs/method.md, "Masks from strokes").
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..formats.events import StageStarted
from ..model.scene import Float64
from .views import ON_BACKGROUND, ON_OBJECT, Mask, View, opencv

STAGE = "masks"
FIRST_BAND, WIDE_BAND, BAND = 0.5, 0.08, 0.04  # see `cut`; for strokes alone, then, at the end
PERSON = 3.0  # weight of a mask that the user made or scribbled on
AGREEMENTS = 1  # rounds in which all photos vote on each photo's mask


class Knowledge(Protocol):
    """Collects photos' votes on points or Gaussians, and projects them into other photos."""

    def learn_strokes(self, view: View) -> None:
        """Count the strokes on a photo as its votes; other pixels do not vote."""

    def learn(self, view: View, mask: Mask, weight: float = 1.0) -> None:
        """Count a photo's mask as its votes, replacing its earlier votes."""

    def prior(self, view: View, *, without: bool = True) -> Prior:
        """The votes on a photo's pixels; `without`: without its own votes."""


def make_masks(
    views: Sequence[View], knowledge: Knowledge, centre: Float64, context: Context = QUIET
) -> dict[str, Mask]:
    """Make the object's masks in all photos: name -> mask, at the size of its view.

    Kept masks do not change, and help to make the others.

    Args:
        views: photos that show the box; at least one with strokes or a mask.
        knowledge: carries masks between photos; without votes yet.
        centre: (3,) of the box.
    """
    masks: dict[str, Mask] = {}
    step, total, started = 0, len(views) * (1 + AGREEMENTS), time.monotonic()
    context.emit(StageStarted(stage=STAGE, total=total))

    def done() -> None:
        nonlocal step
        context.check_cancelled()
        step += 1
        context.progress(STAGE, step, total, started)

    # Start from users' masks and strokes all around the object. Other strokes only correct masks,
    # unless there is nothing else.
    whole = [view for view in views if view.given is not None or fenced(view).any()]
    begun = whole or [view for view in views if view.is_scribbled]
    for view in views:
        if view.given is None and view.is_scribbled:
            knowledge.learn_strokes(view)
    for view in begun:
        mask = view.known
        if mask is None:
            mask = cut(view, knowledge.prior(view, without=False), FIRST_BAND)
        masks[view.name] = mask
        done()
    for view in begun:
        knowledge.learn(view, masks[view.name], PERSON)
    for view in views:
        if view.kept is not None and view not in begun:
            masks[view.name] = view.kept
            knowledge.learn(view, view.kept)
            done()
    for view in _nearest_first(views, [view for view in views if view.name in masks], centre):
        masks[view.name] = cut(view, knowledge.prior(view), WIDE_BAND)
        knowledge.learn(view, masks[view.name])
        done()
    for _ in range(AGREEMENTS):
        for view in views:
            if view.known is None:
                masks[view.name] = cut(view, knowledge.prior(view), BAND)
            done()
        for view in views:
            knowledge.learn(view, masks[view.name], PERSON if view in begun else 1.0)
    return masks


def _nearest_first(views: Sequence[View], begun: Sequence[View], centre: Float64) -> list[View]:
    """Order the other photos: each is the nearest to any before it, as seen from the box."""

    def distance(a: View, b: View) -> float:
        """The difference of two photos' views of the box, from angle and ratio of distances."""
        x, y = a.centre - centre, b.centre - centre
        far, near = float(np.linalg.norm(x)) + 1e-12, float(np.linalg.norm(y)) + 1e-12
        angle = float(np.arccos(np.clip(x @ y / (far * near), -1, 1)))
        return angle + 0.3 * abs(float(np.log(far / near)))

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


Floats = NDArray[np.float32]
SURE_BACKGROUND, SURE_OBJECT, MAYBE_BACKGROUND, MAYBE_OBJECT = range(4)  # OpenCV's numbers
ROUNDS = 5
CERTAIN = 0.9  # a probability above this counts as certain
DOUBT = 0.5  # weight of a guess for unknown parts
LEAST_INSIDE = 0.35  # least likelihood of unknown pixels, if strokes run around the object
LEAST_OUTSIDE = 0.02  # least share of the box's silhouette beyond strokes around the object
RAMP = 0.03  # standard deviation of the outline's place, in the object's size
ISLAND, HOLE = 0.03, 0.003  # as shares of the object; smaller ones are removed


@dataclass(frozen=True, kw_only=True, eq=False)
class Prior:
    """Votes of other photos on one photo's pixels, as shares of each pixel, 0 to 1.

    Attributes:
        in_object: (H, W) share of the object, known or guessed.
        in_box: (H, W) share of the box's content.
        unknown: (H, W) share without votes of other photos.
        trust: weight of these votes relative to the colours, 0 to 1.
    """

    in_object: Floats
    in_box: Floats
    unknown: Floats
    trust: float = 1.0


def cut(view: View, prior: Prior, band: float) -> Mask:
    """Cut the object out of a photo; returns its mask.

    Args:
        view: the photo; its strokes always win.
        prior: the votes of other photos or, at the start, of its own strokes.
        band: how far the outline may be from the prior's outline, in the object's size.
    """
    cv2 = opencv()
    likely = _likelihood(view, prior)
    trimap = _trimap(view, prior, likely > 0.5, band)
    if _is_object(trimap).any() and not _is_object(trimap).all():
        cv2.setRNGSeed(0)  # for the clustering that starts the colour models
        models = np.zeros((1, 65)), np.zeros((1, 65))
        image = _with_likelihood(view, likely, prior.trust)
        cv2.grabCut(image, trimap, None, *models, ROUNDS, cv2.GC_INIT_WITH_MASK)
    # Remove small islands and holes, except where there are strokes.
    mask = _is_object(trimap)
    area = int(mask.sum())
    mask = mask & ~_small(mask, ISLAND * area, view.seeds == ON_OBJECT)
    return mask | _small(~mask, HOLE * area, view.seeds == ON_BACKGROUND)


def _likelihood(view: View, prior: Prior) -> Floats:
    """(H, W) the likelihood that a pixel shows the object, 0 to 1; a ramp across the outline."""
    cv2 = opencv()
    guessed = prior.unknown * (0.5 * prior.in_box - prior.in_object)
    found = prior.in_object + DOUBT * guessed
    if fenced(view).any():
        # The same beyond the strokes: GrabCut would mistake a step there for the object's outline.
        least = LEAST_INSIDE * prior.unknown
        found = np.maximum(found, least + (1 - least) * prior.in_object) * (prior.in_box > 0.5)
    size = math.sqrt((prior.in_object > 0.5).sum())
    ramp: Floats = cv2.GaussianBlur(found.astype(np.float32), (0, 0), max(0.5, RAMP * size))
    return ramp


def _with_likelihood(view: View, likely: Floats, trust: float) -> NDArray[np.uint8]:
    """The input of GrabCut, (H, W, 3): brightness, one channel of colour, and the likelihood.

    As a third channel, the likelihood enters GrabCut's models like a colour. Its ramp separates the
    object from areas of the same colours.
    """
    cv2 = opencv()
    bright, red, blue = cv2.split(cv2.cvtColor(view.smooth, cv2.COLOR_RGB2YCrCb).astype(np.float32))
    channels = np.dstack([bright, (red - blue) / 2 + 128, 255 * (0.5 + trust * (likely - 0.5))])
    return np.ascontiguousarray(channels.clip(0, 255).astype(np.uint8))


def _trimap(view: View, prior: Prior, likely: Mask, band: float) -> NDArray[np.uint8]:
    """The trimap of sure and likely pixels, in OpenCV's numbers."""
    reach = max(2, round(band * math.sqrt(likely.sum())))
    known = prior.unknown < 1 - CERTAIN
    trimap = np.where(likely, np.uint8(MAYBE_OBJECT), np.uint8(MAYBE_BACKGROUND))
    fence = fenced(view)
    if fence.any():
        trimap[~fence & (prior.in_box > 0.5) & (prior.unknown > 0.5)] = MAYBE_OBJECT
        trimap[fence] = SURE_BACKGROUND
    trimap[eroded((prior.in_object > CERTAIN) & known, reach)] = SURE_OBJECT
    trimap[eroded((prior.in_object < 1 - CERTAIN) & known, reach)] = SURE_BACKGROUND
    trimap[eroded(prior.in_box < 1 - CERTAIN, 2)] = SURE_BACKGROUND
    trimap[~view.near_box] = SURE_BACKGROUND
    trimap[view.seeds == ON_OBJECT] = SURE_OBJECT
    trimap[view.seeds == ON_BACKGROUND] = SURE_BACKGROUND
    return trimap


def fenced(view: View) -> Mask:
    """The pixels beyond strokes that run all around the object; none if the strokes have a gap."""
    cv2 = opencv()
    free = (view.seeds != ON_BACKGROUND) & view.near_box
    _, labels = cv2.connectedComponents(free.astype(np.uint8), connectivity=4)
    inside = np.isin(labels, np.unique(labels[(view.seeds == ON_OBJECT) & free])) & free
    outside = view.near_box & free & ~inside
    gap = (inside & ~eroded(view.near_box, 1)).any()
    if gap or not inside.any() or outside.sum() < LEAST_OUTSIDE * view.near_box.sum():
        return np.zeros(free.shape, dtype=bool)
    return np.asarray(~inside)


def eroded(mask: Mask, reach: float) -> Mask:
    """The mask without pixels within `reach` of its outline; the photo's edges are no outline."""
    cv2 = opencv()
    padded = np.pad(mask.astype(np.uint8), 1, mode="edge")
    return np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1] > reach)


def _is_object(trimap: NDArray[np.uint8]) -> Mask:
    return np.asarray((trimap == SURE_OBJECT) | (trimap == MAYBE_OBJECT))


def _small(mask: Mask, area: float, kept: Mask) -> Mask:
    """The connected parts of a mask that are smaller than `area` and have no pixel of `kept`."""
    cv2 = opencv()
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    small = stats[:, cv2.CC_STAT_AREA] < area
    small[np.unique(labels[kept])] = False
    small[0] = False  # pixels outside the mask
    return np.asarray(small[labels])
