"""Which photo a training step sees: pure functions of (seed, step), so a resumed run agrees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..selection.shares import evenly_spread

PhotoAt = Callable[[int], int]


@dataclass(frozen=True, kw_only=True)
class PhotoOrder:
    """An order as data, which a plan holds.

    Attributes:
        kind: `shuffled` (epochs of permutations), `ordered` (as they stand, over and over) or
            `mixed` (`of_boxes`).
        count: of all photos.
        seed: of the epochs.
        selected, drawn, share, full_every: of `mixed`, see `of_boxes`.
    """

    kind: str
    count: int
    seed: int = 0
    selected: tuple[int, ...] = ()
    drawn: tuple[int, ...] = ()
    share: float = 0.0
    full_every: int = 1

    def photo_at(self) -> PhotoAt:
        """Step -> row of the photo it sees."""
        if self.kind == "ordered":
            return ordered(range(self.count))
        if self.kind == "shuffled":
            return shuffled(range(self.count), self.seed)
        return of_boxes(
            self.count,
            self.drawn,
            self.selected,
            share=self.share,
            full_every=self.full_every,
            seed=self.seed,
        )


def ordered(photos: Sequence[int]) -> PhotoAt:
    """The photos in the order given, over and over (paper, sec. III-A)."""
    photos = list(photos)
    return lambda step: photos[step % len(photos)]


def shuffled(photos: Sequence[int], seed: int) -> PhotoAt:
    """Epochs of random permutations, as 3DGS draws them."""
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
    """Steps spread evenly over two sources; `share` of them draw from `second`."""

    def photo_at(step: int) -> int:
        drawn = int(step * share + 1e-9)
        return second(drawn) if evenly_spread(step, share) else first(step - drawn)

    return photo_at


def is_whole(step: int, every: int) -> bool:
    """Whether a step is the one of `every` that looks at a whole photo."""
    return step % every == 0


def with_whole(whole: PhotoAt, partial: PhotoAt, every: int) -> PhotoAt:
    """The steps that `is_whole` names draw from the first source, the others from the second."""

    def photo_at(step: int) -> int:
        before = -(-step // every)  # whole steps before this one
        return whole(before) if is_whole(step, every) else partial(step - before)

    return photo_at


def of_boxes(
    count: int,
    seen: Sequence[int],
    selected: Sequence[int],
    *,
    share: float,
    full_every: int,
    seed: int,
) -> PhotoAt:
    """The order of a stage that looks at boxes.

    Args:
        count: of all photos.
        seen: photos drawn by the steps that look at the boxes.
        selected: photos that `share` of those steps draw.
        full_every: one step of so many draws from all photos instead; 1: none does, `seen` is all.
        seed: of the epochs.
    """
    photo_at = mixed(shuffled(seen, seed), shuffled(selected, seed + 1), share)
    if full_every == 1:
        return photo_at
    return with_whole(shuffled(range(count), seed + 2), photo_at, full_every)
