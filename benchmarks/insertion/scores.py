"""Scores of pictures with inserted objects against the truth: NumPy alone.

Pictures are (H, W, 3) in linear light. `without` is the same view with nothing put in: for ours the
captured scene as it is drawn, for the truth the room itself, so what the capture got wrong counts
for the things but not for their shadow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.float64]
Mask = NDArray[np.bool_]

DARKER = 0.03
"""A pixel is in shadow if the truth takes more than this share of its light."""
FLOOR = 0.005
"""Linear light that is added before a ratio, so that black pixels have one."""
AROUND = 2
"""Pixels on each side that a shadow's ratio is the mean of."""
LEAST = 24
"""Pixels that a view must show of a thing for its score."""


def shown(light: Picture) -> Picture:
    """sRGB values in 0 to 1 of linear light, as Blender's view transform Standard shows it."""
    clipped = np.clip(light, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def psnr(ours: Picture, truth: Picture, mask: Mask) -> float:
    """Decibels of the mask's pixels, as they are shown."""
    error = float(np.mean((shown(ours[mask]) - shown(truth[mask])) ** 2))
    return -10 * float(np.log10(max(error, 1e-10)))


def ratio(after: Picture, before: Picture) -> Picture:
    """The remaining share of a picture's light, (H, W, 3)."""
    return (np.maximum(after, 0) + FLOOR) / (np.maximum(before, 0) + FLOOR)


def smooth_ratio(after: Picture, before: Picture, things: Mask) -> Picture:
    """The remaining light around each pixel, (H, W, 3): textures keep a renderer's noise.

    Both pictures are means of the pixels that are at most `AROUND` away and show no thing.
    """
    own = (~things).astype(np.float64)[..., None]
    share = np.maximum(_summed(own), 1e-9)
    return ratio(*(_summed(np.maximum(each, 0) * own) / share for each in (after, before)))


def _summed(picture: Picture) -> Picture:
    """The sums of the squares around pixels (H, W, C)."""
    (height, width), side = picture.shape[:2], 2 * AROUND + 1
    padded = np.pad(picture, ((AROUND, AROUND), (AROUND, AROUND), (0, 0)))
    parts = [padded[i : i + height, j : j + width] for i in range(side) for j in range(side)]
    return np.asarray(np.sum(parts, axis=0))


def in_shadow(left: Picture, things: Mask) -> Mask:
    """Pixels beside the things to which a `ratio` leaves less light, by more than `DARKER`."""
    return np.asarray((left.mean(axis=-1) < 1 - DARKER) & ~things)


def shadow_error(ours: Picture, truth: Picture, mask: Mask) -> float:
    """Error of a ratio in the shadow, in parts of the error of no shadow at all (ratio 1)."""
    wrong = np.abs(ours[mask] - truth[mask]).sum()
    return float(wrong / max(np.abs(1 - truth[mask]).sum(), 1e-9))


def likeness(ours: Picture, truth: Picture, mask: Mask) -> float:
    """Correlation of two changes of light, as logarithms of ratios, over pixels and channels.

    1: each place and each channel changes as in the truth, up to a common exponent; 0: no likeness,
    also if one of them is the same everywhere.
    """
    first, second = (np.log(np.maximum(each[mask], 1e-6)).ravel() for each in (ours, truth))
    first, second = first - first.mean(), second - second.mean()
    size = float(np.sqrt((first**2).sum() * (second**2).sum()))
    return float((first * second).sum()) / size if size > 1e-9 else 0.0


def strength(ours: Picture, truth: Picture, mask: Mask) -> float:
    """Strength of our changes against the truth: the ratio of their mean logarithms."""
    first, second = (float(np.log(np.maximum(each[mask], 1e-6)).mean()) for each in (ours, truth))
    return first / second if abs(second) > 1e-9 else 0.0


def things_masks(index: NDArray[np.uint8], names: tuple[str, ...]) -> dict[str, Mask]:
    """The pixels of each thing of which the view shows enough.

    Args:
        index: (H, W) which thing each pixel's centre shows, from 1; 0 none.
        names: of the things, in the order of their numbers.
    """
    found = {}
    for number, name in enumerate(names, 1):
        mask = np.asarray(index == number)
        if mask.sum() >= LEAST:
            found[name] = mask
    return found


def widened(mask: Mask) -> Mask:
    """The mask and the pixels beside it: a rim's pixels mix both sides."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    result = grown.copy()
    result[:, 1:] |= grown[:, :-1]
    result[:, :-1] |= grown[:, 1:]
    return np.asarray(result)
