"""How long a batch takes on so many machines, by giving out its parts as the scheduler does."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence

from .parts import Part


def makespan(
    scenes: Sequence[Sequence[Part]], seconds: Mapping[tuple[str, str], float], workers: int
) -> float:
    """Seconds until all parts are done, each on one of `workers` equal workers.

    Args:
        scenes: the parts of each scene.
        seconds: of each part, by its key.
        workers: how many parts can be done at a time.
    """
    needs = {p.key: {(p.scene, name) for name in p.needs} for parts in scenes for p in parts}
    after = _after(scenes, seconds)
    ready = [(-after[key], key) for key, needed in needs.items() if not needed]
    heapq.heapify(ready)
    running: list[tuple[float, tuple[str, str]]] = []
    now = 0.0
    while ready or running:
        while ready and len(running) < workers:
            _, key = heapq.heappop(ready)
            heapq.heappush(running, (now + seconds[key], key))
        now, ended = heapq.heappop(running)
        for key, needed in needs.items():
            if ended in needed:
                needed.remove(ended)
                if not needed:
                    heapq.heappush(ready, (-after[key], key))
    return now


def lower_bound(
    scenes: Sequence[Sequence[Part]], seconds: Mapping[tuple[str, str], float], workers: int
) -> float:
    """Seconds that no order of the parts can beat: all the work, or the longest scene."""
    return max(
        sum(seconds.values()) / max(workers, 1), max(_after(scenes, seconds).values(), default=0.0)
    )


def _after(
    scenes: Sequence[Sequence[Part]], seconds: Mapping[tuple[str, str], float]
) -> dict[tuple[str, str], float]:
    """Seconds from the start of each part to the end of its scene."""
    found: dict[tuple[str, str], float] = {}
    for parts in scenes:
        for part in reversed(parts):
            following = [found[other.key] for other in parts if part.name in other.needs]
            found[part.key] = seconds[part.key] + max(following, default=0.0)
    return found
