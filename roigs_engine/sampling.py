"""Which photo a training step sees: pure functions of (seed, step), so a resumed run agrees."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

PhotoAt = Callable[[int], int]


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
        return second(drawn) if _crosses(step, share) else first(step - drawn)

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


def interleaved(orders: Sequence[Sequence[str]]) -> list[str]:
    """Several ordered selections merged by rank, each name once, best first."""
    merged: dict[str, None] = {}
    for rank in range(max(map(len, orders), default=0)):
        for order in orders:
            if rank < len(order):
                merged.setdefault(order[rank])
    return list(merged)


def reserved(orders: Sequence[Sequence[str]], kept_share: float) -> set[str]:
    """Selected photos that Scene-GS must not see (paper, sec. II-B: half of them).

    Of each selection, in its order, `kept_share` stays with the scene, evenly spread; a photo that
    any ROI reserves is reserved.
    """
    return {
        name
        for order in orders
        for rank, name in enumerate(order)
        if not _crosses(rank, kept_share)
    }


def _crosses(step: int, share: float) -> bool:
    """Whether step (from 0) is one of the `share` of all steps, evenly spread, that are chosen."""
    return int((step + 1) * share + 1e-9) > int(step * share + 1e-9)
