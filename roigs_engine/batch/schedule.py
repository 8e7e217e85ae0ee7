"""Schedules the parts of scenes on an executor, in the order of their dependencies."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from ..context import Context
from ..errors import Stopped
from ..formats.events import Record
from .engine_process import DONE, FAILED, LOST, STOPPED, Outcome
from .local import Report
from .moves import MOST_NODES, RUNNING, WAITING, PartState, next_move, share
from .parts import Key, Part, ScenePlan, costs_after

POLL = 0.5


class Executor(Protocol):
    """An executor of parts; `local.LocalExecutor` describes its methods."""

    def has_capacity(self, part: Part, avoid: tuple[str, ...] = ()) -> bool: ...
    def start(self, part: Part, waiting: int, avoid: tuple[str, ...] = ()) -> int: ...
    def wait(self, seconds: float) -> list[Report]: ...
    def can_move(self, avoid: tuple[str, ...]) -> bool: ...
    def stop(self, part: Part) -> None: ...
    def close(self) -> None: ...


@dataclass(kw_only=True)
class SceneState:
    """The progress of a scene; `reason` says why it failed."""

    plan: ScenePlan
    parts: dict[str, PartState]
    reason: str = ""

    @property
    def state(self) -> str:
        """`waiting`, `running`, `done` or `failed`."""
        states = {part.state for part in self.parts.values()}
        if self.reason:
            return FAILED
        if self.plan.done or states <= {DONE}:
            return DONE
        return WAITING if states == {WAITING} else RUNNING


Told = Callable[[SceneState, "PartState", "Record | Outcome"], None]


class Scheduler:
    """Runs all parts; a failing part ends only its own scene.

    Args:
        scenes: their plans.
        executor: runs parts.
        context: asked whether to stop; receives warnings.
        retries: how often a part may be lost before its scene fails.
        told: called with every event and outcome, after the state has changed.
    """

    def __init__(
        self,
        scenes: Sequence[ScenePlan],
        executor: Executor,
        context: Context,
        *,
        retries: int,
        told: Told,
    ) -> None:
        self.scenes = {
            plan.name: SceneState(
                plan=plan,
                parts={
                    p.name: PartState(part=p, state=DONE if plan.done else WAITING)
                    for p in plan.parts
                },
            )
            for plan in scenes
        }
        self._executor, self._context = executor, context
        self._retries, self._told = retries, told
        self._slow: tuple[str, ...] = ()  # nodes from which a part was moved
        self._after: dict[Key, float] = {}
        for plan in scenes:
            self._after |= costs_after(plan.parts, {p.key: p.work for p in plan.parts})

    def run(self) -> None:
        """Run all parts; Stopped on request, finished work is kept."""
        stopped = False
        while any(part.state == RUNNING for _, part in self._states()) or (
            not stopped and self._ready()
        ):
            stopped = stopped or self._context.should_stop()
            if not stopped:
                self._start()
            for part, report in self._executor.wait(POLL):
                self._take(part, report)
        if stopped or self._context.should_stop():
            raise Stopped

    def _states(self) -> Iterable[tuple[SceneState, PartState]]:
        return ((s, part) for s in self.scenes.values() for part in s.parts.values())

    def _ready(self) -> list[tuple[SceneState, PartState]]:
        """Parts that can start, longest remaining path first, to end the batch sooner."""
        ready = [
            (scene, part)
            for scene, part in self._states()
            if part.state == WAITING
            and not scene.reason
            and all(scene.parts[name].state == DONE for name in part.part.needs)
        ]
        return sorted(ready, key=lambda pair: -pair[1].left - self._after[pair[1].part.key])

    def _start(self) -> None:
        ready = self._ready()
        for index, (_, state) in enumerate(ready):
            avoid = tuple(dict.fromkeys((*state.avoid, *self._slow)))
            if self._executor.has_capacity(state.part, avoid):
                state.state, state.started = RUNNING, time.monotonic()
                state.cores = self._executor.start(state.part, len(ready) - index - 1, avoid)
        if self._executor.can_move(self._slow):
            self._move([state for _, state in ready if state.state == WAITING])

    def _move(self, ready: Sequence[PartState]) -> None:
        """Stop a part that should resume elsewhere or later, if there is one."""
        states = [state for _, state in self._states()]
        idle = bool(states) and self._executor.has_capacity(states[0].part, self._slow)
        found = next_move(states, self._after, ready, time.monotonic(), idle=idle)
        if found is not None:
            found.state.moving, found.state.from_slow = True, found.slow
            self._executor.stop(found.state.part)

    def _take(self, part: Part, report: Record | Outcome) -> None:
        scene = self.scenes[part.scene]
        state = scene.parts[part.name]
        if isinstance(report, Outcome):
            self._end(scene, state, report)
            self._told(scene, state, report)
            return
        if not state.seen:
            state.seen, state.started = True, time.monotonic()
        if report["event"] in ("progress", "stagestarted"):
            state.progress = report
            if report["event"] == "progress" and not state.first[0]:
                state.first = (time.monotonic(), share(state))
        self._told(scene, state, report)

    def _end(self, scene: SceneState, state: PartState, outcome: Outcome) -> None:
        state.kept = share(state)
        state.state, label, moving, node = WAITING, state.part.label, state.moving, outcome.node
        state.moving = state.seen = False
        if outcome.state == DONE:
            state.state, state.seconds = DONE, time.monotonic() - state.started
        elif outcome.state == LOST:
            state.lost += 1
            if state.lost > self._retries:
                self._fail(scene, state, f"{outcome.reason} It was tried {state.lost} times.")
            else:
                self._context.warn(f"{label}: {outcome.reason} It is tried again.")
        elif outcome.state == FAILED:
            avoid = (*state.avoid, node)
            if len(avoid) < MOST_NODES and self._executor.can_move(avoid):
                state.avoid = avoid
                self._context.warn(f"{label}: {outcome.reason} It is tried on another machine.")
            else:
                self._fail(scene, state, outcome.reason)
        else:
            assert outcome.state == STOPPED
            if moving and state.from_slow:
                state.avoid, self._slow = (*state.avoid, node), (*self._slow, node)
                self._context.info(f"{label}: resumes on a faster machine.")
            elif moving:
                state.made_way = True
                self._context.info(f"{label}: makes room for a longer one.")
        if outcome.state != DONE:
            state.first = (0.0, 0.0)

    def _fail(self, scene: SceneState, state: PartState, reason: str) -> None:
        state.state = FAILED
        scene.reason = scene.reason or f"{state.part.label}: {reason}"
        self._context.warn(f"{state.part.label}: {reason} The other scenes continue.")
