"""Decides which running part to move to another machine or a later time, to end the batch sooner.

A batch ends with its last part. So the longest remaining part must run, and not on a slow machine.
A part on a slow machine moves to another one. A short part makes room for a long part from a lost
or slow machine. Parts are stopped with a checkpoint, so a move costs only the few seconds that an
engine takes to start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median

from ..formats.events import Record
from .engine_process import DONE
from .parts import Part

WAITING, RUNNING = "waiting", "running"
BEFORE = ("photos", "undistort")  # work that is reported before the stages
SLOW, SHORT = 2.0, 0.5  # x the usual time left; x the time left of the part it makes room for
WORTH_MOVING = 60.0  # seconds left
SEEN_SECONDS = 30.0  # of progress needed to measure a part's speed
ENOUGH_SEEN = 3  # parts needed for a median
MOST_NODES = 3  # nodes on which a part may fail or be slow


@dataclass(kw_only=True)
class PartState:
    """The progress of a part."""

    part: Part  # the part
    state: str = WAITING  # `waiting`, `running`, `done`, `failed`
    lost: int = 0  # how often its process was lost
    avoid: tuple[str, ...] = ()  # nodes where it failed, or that are slow
    cores: int = 1  # cores assigned to it
    progress: Record = field(default_factory=dict)  # the last event with its progress
    started: float = 0.0  # `time.monotonic()` of its first event; before that, of its assignment
    first: tuple[float, float] = (0.0, 0.0)  # time and share at its first progress; zeros: none yet
    seconds: float = 0.0  # duration of a finished part
    kept: float = 0.0  # its share when it last stopped or was lost
    moving: bool = False  # whether it was asked to stop, to resume elsewhere or later
    from_slow: bool = False  # whether it moves because its machine is slow
    made_way: bool = False  # whether it made room for a longer part, which happens at most once
    seen: bool = False  # whether it had an event; until then it may wait for a machine

    @property
    def left(self) -> float:
        """Its remaining work."""
        return self.part.work * (1 - share(self))


@dataclass(frozen=True, kw_only=True)
class Move:
    """A part to stop, and whether its machine is slow (then it gets no more parts)."""

    state: PartState
    slow: bool


def share(state: PartState) -> float:
    """The finished share of a part, 0 to 1: as saved, or by its last progress if that is more."""
    return 1.0 if state.state == DONE else max(state.kept, _shown(state))


def _shown(state: PartState) -> float:
    """The share of a part by its last progress and its stages' work."""
    total, step = state.progress.get("total"), state.progress.get("step")
    if state.state != RUNNING or not total or step is None or not state.part.work:
        return 0.0
    done, at, whole = 0.0, state.progress.get("stage"), state.part.work
    for name, work in state.part.stages:
        if name == at:
            return float(min(1.0, (done + work * step / total) / whole))
        done += work
    # Not a stage: reading photos comes before all stages, evaluation after them.
    return 0.0 if at in BEFORE else sum(w for name, w in state.part.stages if name) / whole


def next_move(
    states: Sequence[PartState],
    after: Mapping[tuple[str, str], float],
    ready: Sequence[PartState],
    now: float,
    *,
    idle: bool,
) -> Move | None:
    """Choose the next part to stop; None: none.

    Args:
        states: all parts.
        after: key of a part -> the work after it, on the longest path.
        ready: parts that only wait for a machine.
        now: `time.monotonic()`.
        idle: whether a machine has nothing to do.
    """
    usual = _Usual(states, now)
    if usual.overall is None:
        return None
    running = [s for s in states if s.state == RUNNING]
    # Seconds left for the parts with a known speed.
    ends = {s.part.key: r * s.left for s in running if (r := _rate(s, now)) is not None}
    # Seconds until the end of the batch if the remaining work were shared evenly.
    rest = sum(usual.left(s) for s in states if s.state == WAITING)
    rest += sum(ends.get(s.part.key, usual.left(s)) for s in running)
    rest /= max(len(running), 1)
    movable = [
        (ends[s.part.key] + usual.overall * after[s.part.key], s)
        for s in running
        if ends.get(s.part.key, 0.0) > WORTH_MOVING and not s.moving
    ]
    slow = [
        (left, s)
        for left, s in movable
        if len(s.avoid) < MOST_NODES and usual.knows(s) and ends[s.part.key] > SLOW * usual.left(s)
    ]
    if slow:
        left, last = max(slow, key=lambda pair: pair[0])
        if (left > rest) if ready else idle:
            return Move(state=last, slow=True)
    longest = max((usual.left(s) + usual.overall * after[s.part.key] for s in ready), default=0.0)
    short = [(left, s) for left, s in movable if left < SHORT * longest and not s.made_way]
    if short and longest > rest + WORTH_MOVING and not any(s.moving for s in running):
        return Move(state=min(short, key=lambda pair: pair[0])[1], slow=False)
    return None


class _Usual:
    """Median seconds for a unit of work: overall, and for each kind of parts (name, cores, GPU).

    Kinds with too few parts are missing; `overall` is None if there are too few parts at all.
    """

    def __init__(self, states: Sequence[PartState], now: float) -> None:
        rates: dict[tuple[str, int, bool], list[float]] = {}
        for state in states:
            rate = _rate(state, now)
            if rate is not None:
                rates.setdefault(_kind(state), []).append(rate)
        seen = [rate for each in rates.values() for rate in each]
        self.overall = median(seen) if len(seen) >= ENOUGH_SEEN else None
        self._alike = {k: median(each) for k, each in rates.items() if len(each) >= ENOUGH_SEEN}

    def knows(self, state: PartState) -> bool:
        """Whether enough parts like this one were seen."""
        return _kind(state) in self._alike

    def left(self, state: PartState) -> float:
        """Seconds that the remaining work of a part usually takes."""
        return self._alike.get(_kind(state), self.overall or 0.0) * state.left


def _kind(state: PartState) -> tuple[str, int, bool]:
    return state.part.name, state.cores, state.part.gpu


def _rate(state: PartState, now: float) -> float | None:
    """Seconds for a unit of a part's work, from its progress; None: unknown."""
    began, before = state.first
    if not began or not state.part.work or state.state not in (DONE, RUNNING):
        return None
    until = state.started + state.seconds if state.state == DONE else now
    done = share(state) - before
    if done <= 0 or until - began < SEEN_SECONDS:
        return None
    return (until - began) / (done * state.part.work)
