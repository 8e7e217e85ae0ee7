"""Does the parts of scenes in an order that their needs allow, on an executor."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Protocol

from ..context import Context
from ..errors import Stopped
from ..formats.events import Record
from .engine_process import DONE, FAILED, LOST, STOPPED, Outcome
from .local import Report
from .parts import Part, ScenePlan

POLL = 0.5
WAITING, RUNNING = "waiting", "running"
BEFORE = ("photos", "undistort")  # work with progress that comes before the stages
SLOW, WORTH_MOVING = 2.0, 60.0  # times as long as usual; seconds that are left
ENOUGH_DONE = 3  # parts that tell what is usual
MOST_NODES = 3  # on which a part may fail before its error counts


class Executor(Protocol):
    """Where parts are done; `local.LocalExecutor` says what its methods do."""

    def has_room(self, part: Part) -> bool: ...
    def start(self, part: Part, waiting: int, avoid: tuple[str, ...] = ()) -> None: ...
    def wait(self, seconds: float) -> list[Report]: ...
    def can_move(self, avoid: tuple[str, ...]) -> bool: ...
    def is_idle(self) -> bool: ...
    def stop(self, part: Part) -> None: ...
    def close(self) -> None: ...


@dataclass(kw_only=True)
class PartState:
    """How far a part is.

    Attributes:
        part: the part.
        state: `waiting`, `running`, `done`, `failed`.
        lost: how often its process was lost.
        avoid: nodes where it failed.
        progress: the last event with its progress.
        started: `time.monotonic()` of its first event, or of when it was given out.
        seen: whether it had an event; until then it may wait for a machine.
        first: `time.monotonic()` of its first progress, and its share then; zeros: none yet.
        seconds: it took, once it is done.
        moving: whether it was asked to stop, to go on on another machine.
    """

    part: Part
    state: str = WAITING
    lost: int = 0
    avoid: tuple[str, ...] = ()
    progress: Record = field(default_factory=dict)
    started: float = 0.0
    first: tuple[float, float] = (0.0, 0.0)
    seconds: float = 0.0
    moving: bool = False
    seen: bool = False


def share(state: PartState) -> float:
    """How much of a part is done, 0 to 1, by its stages' work and the last progress."""
    if state.state == DONE:
        return 1.0
    total, step = state.progress.get("total"), state.progress.get("step")
    if state.state != RUNNING or not total or step is None or not state.part.work:
        return 0.0
    done, at, whole = 0.0, state.progress.get("stage"), state.part.work
    for name, work in state.part.stages:
        if name == at:
            return float(min(1.0, (done + work * step / total) / whole))
        done += work
    # Not a stage: looking at photos comes before all of them, evaluation after them.
    return 0.0 if at in BEFORE else sum(w for name, w in state.part.stages if name) / whole


@dataclass(kw_only=True)
class SceneState:
    """How far a scene is; `reason` says why it failed."""

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
    """Does all parts; a part that fails ends its scene alone.

    Args:
        scenes: their plans.
        executor: does parts.
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
        self._after = {
            state.part.key: _work_after(state.part, scene.plan.parts)
            for scene in self.scenes.values()
            for state in scene.parts.values()
        }

    def run(self) -> None:
        """Do all parts.

        Raises:
            Stopped: on request; what is done so far is kept.
        """
        stopped = False
        while self._running() or (not stopped and self._ready()):
            stopped = stopped or self._context.should_stop()
            if not stopped:
                self._start()
            for part, report in self._executor.wait(POLL):
                self._take(part, report)
        if stopped or self._context.should_stop():
            raise Stopped

    def _states(self) -> Iterable[tuple[SceneState, PartState]]:
        return ((s, part) for s in self.scenes.values() for part in s.parts.values())

    def _running(self) -> bool:
        return any(part.state == RUNNING for _, part in self._states())

    def _ready(self) -> list[tuple[SceneState, PartState]]:
        """Parts that can start; those with most work after them first, which ends sooner."""
        ready = [
            (scene, part)
            for scene, part in self._states()
            if part.state == WAITING
            and not scene.reason
            and all(scene.parts[name].state == DONE for name in part.part.needs)
        ]
        return sorted(ready, key=lambda pair: -self._after[pair[1].part.key])

    def _start(self) -> None:
        ready = self._ready()
        for index, (_, state) in enumerate(ready):
            if self._executor.has_room(state.part):
                state.state, state.started = RUNNING, time.monotonic()
                self._executor.start(state.part, len(ready) - index - 1, state.avoid)
        if not ready and self._executor.is_idle():
            slow = straggler([part for _, part in self._states()], time.monotonic())
            if slow is not None:
                slow.moving = True
                self._executor.stop(slow.part)

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
        state.state, label, moving = WAITING, state.part.label, state.moving
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
            avoid = (*state.avoid, outcome.node)
            if len(avoid) < MOST_NODES and self._executor.can_move(avoid):
                state.avoid = avoid
                self._context.warn(f"{label}: {outcome.reason} It is tried on another machine.")
            else:
                self._fail(scene, state, outcome.reason)
        else:
            assert outcome.state == STOPPED
            if moving:
                state.avoid = (*state.avoid, outcome.node)
                self._context.info(f"{label}: goes on on a faster machine.")
        if outcome.state != DONE:
            state.first = (0.0, 0.0)

    def _fail(self, scene: SceneState, state: PartState, reason: str) -> None:
        state.state = FAILED
        scene.reason = scene.reason or f"{state.part.label}: {reason}"
        self._context.warn(f"{state.part.label}: {reason} The other scenes go on.")


def straggler(states: Sequence[PartState], now: float) -> PartState | None:
    """The part that runs so slowly that it should go on elsewhere; None: there is none.

    It is compared with parts of the same name, which other scenes have; each is moved once.
    """
    took: dict[str, list[float]] = {}
    for state in states:
        began, before = state.first
        if state.state == DONE and began and state.seconds and before < 0.5:
            each = (state.started + state.seconds - began) / (1 - before) / state.part.work
            took.setdefault(state.part.name, []).append(each)
    found: list[tuple[float, PartState]] = []
    for state in states:
        usual, (began, before) = took.get(state.part.name, []), state.first
        done = share(state)
        if state.state != RUNNING or state.avoid or state.moving or len(usual) < ENOUGH_DONE:
            continue
        if began and done > before:
            whole = (now - began) / (done - before)
            if whole > SLOW * median(usual) * state.part.work and whole * (1 - done) > WORTH_MOVING:
                found.append((whole * (1 - done), state))
    return max(found, key=lambda pair: pair[0])[1] if found else None


def _work_after(part: Part, parts: Sequence[Part]) -> float:
    """The work of the part and of the longest way from it to the scene's end."""
    following = [other for other in parts if part.name in other.needs]
    return part.work + max((_work_after(other, parts) for other in following), default=0.0)
