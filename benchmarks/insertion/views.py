"""The pictures of a folder: which there are, and what they score beside the truth's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import scores
from .scores import Picture

THINGS = ("grey ball", "mirror ball", "glass", "monkey")
"""In the order of their numbers in the pictures of indices; the vase's follows."""
VASE = len(THINGS) + 1
VIEWS = 12
"""So many of a run's test photos are compared: those that show most of the things."""
MEASURES = (*(f"{name} (dB)" for name in THINGS), "shadow", "lamp", "its strength")


@dataclass(frozen=True, kw_only=True)
class View:
    """Measures of one photo's place; those that it does not show are missing."""

    photo: str
    found: dict[str, float]


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
    """Which thing each pixel shows (H, W): 0 none, `VASE` the captured vase."""
    found: NDArray[np.uint8] = np.load(picture_file(folder, photo, "index"))
    return found


def photos_that_show_most(folder: Path, photos: list[str], count: int = VIEWS) -> list[str]:
    """The photos with most pixels of things and of the vase, in their given order."""
    pixels = {photo: int((index_of(folder, photo) > 0).sum()) for photo in photos}
    first = sorted(photos, key=lambda photo: -pixels[photo])[:count]
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
    left, true_left = _ratio(ours, photo, "with"), _ratio(truth, photo, "with")
    if left is not None and true_left is not None:
        # A rim's pixels show both the thing and what is behind it.
        shadow = scores.in_shadow(true_left, scores.widened(things > 0))
        if shadow.sum() >= scores.LEAST:
            found["shadow"] = scores.shadow_error(left, true_left, shadow)
    lit, true_lit = _ratio(ours, photo, "lamp"), _ratio(truth, photo, "lamp")
    vase = np.asarray(index == VASE)
    if lit is not None and true_lit is not None and vase.sum() >= scores.LEAST:
        found["lamp"] = scores.likeness(lit, true_lit, vase)
        found["its strength"] = scores.strength(lit, true_lit, vase)
    return View(photo=photo, found=found)


def _ratio(folder: Path, photo: str, state: str) -> Picture | None:
    """What a state leaves of the light (H, W, 3)."""
    after, before = load(folder, photo, state), load(folder, photo, "without")
    return None if after is None or before is None else scores.ratio(after, before)


def means(views: list[View]) -> dict[str, float]:
    """The mean of each measure over the views that have it."""
    every = {name: [view.found[name] for view in views if name in view.found] for name in MEASURES}
    return {name: float(np.mean(values)) for name, values in every.items() if values}
