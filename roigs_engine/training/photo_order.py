"""The photo of each training step, a pure function of (seed, step), also in a resumed run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..selection.split import in_even_share

PhotoAt = Callable[[int], int]
Item = TypeVar("Item")


@dataclass(frozen=True, kw_only=True)
class PhotoOrder:
    """An order of photos as data, part of a plan.

    Attributes:
        kind: `shuffled` (epochs of permutations), `ordered` (repeated in their order) or `mixed`,
            which is for training on masks.
        count: number of all photos.
        seed: of the epochs.
        drawn: for `mixed`, the photos from which steps with a mask draw.
        selected, share: for `mixed`, selected photos, and the share of these steps that draw one.
        whole_share: for `mixed`, the share of steps that draw from all photos.
    """

    kind: str
    count: int
    seed: int = 0
    selected: tuple[int, ...] = ()
    drawn: tuple[int, ...] = ()
    share: float = 0.0
    whole_share: float = 0.0

    def photo_at(self) -> PhotoAt:
        """Return the function step -> position of its photo."""
        if self.kind == "ordered":
            return lambda step: step % self.count  # paper, sec. III-A
        if self.kind == "shuffled":
            return shuffled(range(self.count), self.seed)
        selected = shuffled(self.selected, self.seed + 1)
        photo_at = mixed(shuffled(self.drawn, self.seed), selected, self.share)
        whole = shuffled(range(self.count), self.seed + 2)
        return mixed(photo_at, whole, self.whole_share)


def shuffled(photos: Sequence[int], seed: int) -> PhotoAt:
    """Return an order by epochs of random permutations, as in 3DGS."""
    photos = list(photos)
    cached: tuple[int, NDArray[np.int64]] = (-1, np.empty(0, dtype=np.int64))

    def photo_at(step: int) -> int:
        nonlocal cached
        epoch, position = divmod(step, len(photos))
        if cached[0] != epoch:
            cached = (epoch, np.random.default_rng([seed, epoch]).permutation(len(photos)))
        return photos[int(cached[1][position])]

    return photo_at


def mixed(first: PhotoAt, second: PhotoAt, share: float) -> PhotoAt:
    """Mix two orders: `share` of the steps, evenly spread, draw from `second`."""

    def photo_at(step: int) -> int:
        drawn = int(step * share + 1e-9)
        return second(drawn) if in_even_share(step, share) else first(step - drawn)

    return photo_at


def evenly_spaced(items: Sequence[Item], most: int) -> list[Item]:
    """Return at most `most` of the items, evenly spaced, in order, with the first and the last."""
    places = np.linspace(0, len(items) - 1, min(most, len(items))).round()
    return [items[int(place)] for place in places]
