"""The photo of each training step: a pure function of (seed, step), so a resumed run agrees."""

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
        kind: `shuffled` (epochs of permutations), `ordered` (repeated in their order) or `mixed`
            (`box_order`).
        count: number of all photos.
        seed: of the epochs.
        selected, drawn, share, full_every: of `mixed`, see `box_order`.
    """

    kind: str
    count: int
    seed: int = 0
    selected: tuple[int, ...] = ()
    drawn: tuple[int, ...] = ()
    share: float = 0.0
    full_every: int = 1

    def photo_at(self) -> PhotoAt:
        """The function step -> position of its photo."""
        if self.kind == "ordered":
            return ordered(range(self.count))
        if self.kind == "shuffled":
            return shuffled(range(self.count), self.seed)
        return box_order(
            self.count,
            self.drawn,
            self.selected,
            share=self.share,
            full_every=self.full_every,
            seed=self.seed,
        )


def ordered(photos: Sequence[int]) -> PhotoAt:
    """The photos in the order given, repeated (paper, sec. III-A)."""
    photos = list(photos)
    return lambda step: photos[step % len(photos)]


def shuffled(photos: Sequence[int], seed: int) -> PhotoAt:
    """Epochs of random permutations, as in 3DGS."""
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
    """Two orders mixed: `share` of the steps, evenly spread, draw from `second`."""

    def photo_at(step: int) -> int:
        drawn = int(step * share + 1e-9)
        return second(drawn) if in_even_share(step, share) else first(step - drawn)

    return photo_at


def is_whole(step: int, every: int) -> bool:
    """Whether a step is the one in `every` that uses a whole photo."""
    return step % every == 0


def with_whole(whole: PhotoAt, partial: PhotoAt, every: int) -> PhotoAt:
    """Two orders mixed: steps with `is_whole` draw from `whole`, the others from `partial`."""

    def photo_at(step: int) -> int:
        before = -(-step // every)  # whole steps before this one
        return whole(before) if is_whole(step, every) else partial(step - before)

    return photo_at


def box_order(
    count: int,
    seen: Sequence[int],
    selected: Sequence[int],
    *,
    share: float,
    full_every: int,
    seed: int,
) -> PhotoAt:
    """The order of a stage that trains on masks.

    Args:
        count: number of all photos.
        seen: photos that the steps with a mask draw from.
        selected: selected photos.
        share: share of the steps with a mask that draw from `selected` instead.
        full_every: one step in `full_every` draws from all photos; 1: all draw as above.
        seed: of the epochs.
    """
    photo_at = mixed(shuffled(seen, seed), shuffled(selected, seed + 1), share)
    if full_every == 1:
        return photo_at
    return with_whole(shuffled(range(count), seed + 2), photo_at, full_every)


def evenly_spaced(items: Sequence[Item], most: int) -> list[Item]:
    """At most so many of the items, evenly spaced, in their order; the first and the last."""
    places = np.linspace(0, len(items) - 1, min(most, len(items))).round()
    return [items[int(place)] for place in places]
