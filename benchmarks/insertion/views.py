"""The pictures of a folder: which there are, and what they score beside the truth's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import scores
from .scores import Mask, Picture

THINGS = ("grey ball", "mirror ball", "glass", "monkey")
"""In the order of their numbers in the pictures of indices; the vase's follows."""
VASE = len(THINGS) + 1
ROWS = ("nothing", "mean", "light", "catch", "all")
"""Blender's usual grey world; a world of the panorama's mean colour; light from the scene; with
shadows on captured things; with reflections and bounce, too."""
LAMP = "lamp"
"""A row for itself: the relit vase beside the lamp, without the things on the table."""
VIEWS = 12
"""So many of a run's test photos are compared: those that show most of the things."""
MEASURES = (*(f"{name} (dB)" for name in THINGS), "shadow", "lamp", "its strength")


@dataclass(frozen=True, kw_only=True)
class View:
    """Measures of one photo's place; those that it does not show are missing."""

    photo: str
    found: dict[str, float]
    changes: tuple[Picture, Picture] | None = None  # of the light on the vase's pixels (N, 3)


def picture_file(folder: Path, photo: str, state: str) -> Path:
    """The file of a picture: linear light (H, W, 3), or `index` (H, W).

    Args:
        photo: the photo from whose place it is.
        state: "with" the things, "without", with the "lamp", or the truth's "index".
    """
    return folder / f"{photo.removesuffix('.jpg').replace('/', '_')}-{state}.npy"


def load(folder: Path, photo: str, state: str) -> Picture | None:
    """A picture as float64; None if there is none."""
    file = picture_file(folder, photo, state)
    return np.load(file).astype(np.float64) if file.exists() else None


def index_of(folder: Path, photo: str) -> NDArray[np.uint8]:
    """Index of the object in each pixel (H, W): 0 none, `VASE` the captured vase."""
    found: NDArray[np.uint8] = np.load(picture_file(folder, photo, "index"))
    return found


def photos_that_show_most(folder: Path, photos: list[str], count: int = VIEWS) -> list[str]:
    """The photos with most pixels of things and of the vase, in their given order.

    Those without a picture of indices are left out: the truth is not rendered whole.
    """
    there = [photo for photo in photos if picture_file(folder, photo, "index").exists()]
    pixels = {photo: int((index_of(folder, photo) > 0).sum()) for photo in there}
    first = sorted(there, key=lambda photo: -pixels[photo])[:count]
    return [photo for photo in photos if photo in first]


def measured(ours: Path, truth: Path, photo: str) -> View:
    """The measures of a photo's pictures in a folder, as far as both folders have them."""
    index = index_of(truth, photo)
    things = np.where(index == VASE, 0, index).astype(np.uint8)
    found: dict[str, float] = {}
    after, true_after = load(ours, photo, "with"), load(truth, photo, "with")
    if after is not None and true_after is not None:
        for name, mask in scores.things_masks(things, THINGS).items():
            found[f"{name} (dB)"] = scores.psnr(after, true_after, mask)
    beside = scores.widened(things > 0)  # a rim's pixels show both the thing and what is behind
    left, true_left = (_ratio(folder, photo, "with", beside) for folder in (ours, truth))
    if left is not None and true_left is not None:
        shadow = scores.in_shadow(true_left, beside)
        if shadow.sum() >= scores.LEAST:
            found["shadow"] = scores.shadow_error(left, true_left, shadow)
    vase = np.asarray(index == VASE)
    lit, true_lit = (_ratio(folder, photo, "lamp", ~vase) for folder in (ours, truth))
    changes = None
    if lit is not None and true_lit is not None and vase.sum() >= scores.LEAST:
        changes = lit[vase], true_lit[vase]
        found |= lamp([changes])
    return View(photo=photo, found=found, changes=changes)


def lamp(changes: Sequence[tuple[Picture, Picture]]) -> dict[str, float]:
    """The measures of the lamp, over the vase's pixels of all views: some see its dark side."""
    ours, truth = (np.concatenate(parts)[None] for parts in zip(*changes, strict=True))
    every = np.ones(ours.shape[:2], bool)
    names = MEASURES[-2:]
    values = scores.likeness(ours, truth, every), scores.strength(ours, truth, every)
    return dict(zip(names, values, strict=True))


def _ratio(folder: Path, photo: str, state: str, without: Mask) -> Picture | None:
    """The share of the light (H, W, 3) that remains in a state, around each pixel, without some."""
    after, before = load(folder, photo, state), load(folder, photo, "without")
    if after is None or before is None:
        return None
    return scores.smooth_ratio(after, before, without)


def means(views: list[View]) -> dict[str, float]:
    """The mean of each measure over the views that have it; the lamp's, over all pixels."""
    every = {name: [view.found[name] for view in views if name in view.found] for name in MEASURES}
    found = {name: float(np.mean(values)) for name, values in every.items() if values}
    changes = [view.changes for view in views if view.changes is not None]
    return found | (lamp(changes) if changes else {})
