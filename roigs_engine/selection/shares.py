"""Distributes the selected photos over the stages."""

from __future__ import annotations

from collections.abc import Sequence


def interleaved(orders: Sequence[Sequence[str]]) -> list[str]:
    """Several selections merged by rank, each name once, best first."""
    merged: dict[str, None] = {}
    for rank in range(max(map(len, orders), default=0)):
        for order in orders:
            if rank < len(order):
                merged.setdefault(order[rank])
    return list(merged)


def reserved(orders: Sequence[Sequence[str]], kept_share: float) -> set[str]:
    """Selected photos that the Scene-GS must not use (paper, sec. II-B: half of them).

    The Scene-GS may use the share `kept_share` of each selection, evenly spread over its order. A
    photo that any box reserves is reserved.
    """
    return {
        name
        for order in orders
        for rank, name in enumerate(order)
        if not evenly_spread(rank, kept_share)
    }


def evenly_spread(step: int, share: float) -> bool:
    """Whether `step` (from 0) belongs to the share `share` of all steps, evenly spread."""
    return int((step + 1) * share + 1e-9) > int(step * share + 1e-9)
