"""Which selected photos go to which stage."""

from __future__ import annotations

from collections.abc import Sequence


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
        if not evenly_spread(rank, kept_share)
    }


def evenly_spread(step: int, share: float) -> bool:
    """Whether step (from 0) is one of the `share` of all steps, evenly spread, that are chosen."""
    return int((step + 1) * share + 1e-9) > int(step * share + 1e-9)
