"""Scenes of made-up parts, and an executor that does them in an instant."""

from __future__ import annotations

from collections.abc import Callable

from roigs_engine.batch.engine_process import DONE, Outcome
from roigs_engine.batch.local import Report
from roigs_engine.batch.parts import Part, ScenePlan

Ends = Callable[[Part, tuple[str, ...]], Outcome]


def part(scene: str, name: str, *needs: str, work: float = 1.0, memory: int = 0) -> Part:
    stages = (("joint", work),)
    return Part(
        scene=scene, name=name, argv=("run",), needs=needs, work=work, memory=memory, stages=stages
    )


def scene(name: str, *parts: Part, done: bool = False) -> ScenePlan:
    return ScenePlan(name=name, objects=(f"{name}-box",), steps=(), parts=parts, done=done)


class Instant:
    """Ends each part as it is told; records the order, and the most parts at a time."""

    def __init__(self, ends: Ends | None = None, *, room: int = 1, machines: int = 1) -> None:
        self.order: list[str] = []
        self.asked: list[str] = []
        self.avoided: list[tuple[str, ...]] = []
        self._ends: Ends = ends or (lambda part, avoid: Outcome(state=DONE))
        self._room, self._machines = room, machines
        self._running: list[tuple[Part, tuple[str, ...]]] = []

    def has_capacity(self, part: Part, avoid: tuple[str, ...] = ()) -> bool:
        return len(self._running) < self._room

    def start(self, part: Part, waiting: int, avoid: tuple[str, ...] = ()) -> int:
        self.order.append(part.label)
        self.avoided.append(avoid)
        self._running.append((part, avoid))
        return 1

    def wait(self, seconds: float) -> list[Report]:
        if not self._running:
            return []
        part, avoid = self._running.pop(0)
        return [(part, self._ends(part, avoid))]

    def can_move(self, avoid: tuple[str, ...]) -> bool:
        return len(set(avoid)) < self._machines

    def stop(self, part: Part) -> None:
        self.asked.append(part.label)

    def close(self) -> None:
        pass
