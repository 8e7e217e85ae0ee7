"""Simulates the time of a batch on many machines, some of them slow, some lost.

    python -m benchmarks.cluster_model BATCH [--objects 200] [--machines 10 100] [--out DIR]

BATCH is the folder of a finished batch (`--run-dir`), whose scenes' stage times are drawn from. The
machines are equal but for stragglers. Parts are given out as `roigs_engine.batch.schedule` does,
and moved by its own rule; one whose machine is lost goes on elsewhere from its last checkpoint. The
bound is the time in which the machines that are left at each moment can do all the work, or that
the longest scene takes.
Writes `cluster_model.md` and, with matplotlib (the extra `study`), `cluster_model.png`.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.markdown import table
from roigs_engine.batch.engine_process import DONE
from roigs_engine.batch.moves import RUNNING, WAITING, PartState, next_move, share
from roigs_engine.batch.parts import Part
from roigs_engine.batch.times import START
from roigs_engine.formats.run_files import STAGE, STAGES
from roigs_engine.run.stage_folder import CHECKPOINT_SECONDS, read_record

HOUR = 3600.0
LOOK = 10.0  # seconds between two checks of the scheduler; the real one checks more often
PERCENT_LOST, SLOW_SHARE, SLOWNESS = 5.0, 0.05, 3.0
HEAD = ("machines", "objects", "lost", "hours", "bound, h", "hours / bound", "worst of seeds")


@dataclass(frozen=True)
class World:
    """Properties of the simulated machines.

    Attributes:
        machines: number of machines.
        lost: share of the machines lost per hour.
        slow: share of stragglers, which take `SLOWNESS` times as long.
        seed: decides which machines are slow, and when they are lost.
        moves: whether parts may resume elsewhere or later (`roigs_engine.batch.moves`).
    """

    machines: int
    lost: float = PERCENT_LOST / 100
    slow: float = SLOW_SHARE
    seed: int = 0
    moves: bool = True


@dataclass(kw_only=True)
class Given:
    """A part at work on a machine.

    Attributes:
        state: the part's state, as the scheduler sees it.
        machine: number of the machine.
        began: time at which the part was assigned.
        kept: seconds of its work that were done before.
    """

    state: PartState
    machine: int
    began: float
    kept: float

    def done(self, now: float, speed: float) -> float:
        """Seconds of its work that are done."""
        return min(self.kept + max(0.0, now - self.began - START) * speed, self.state.part.work)

    def ends(self, speed: float) -> float:
        """The time at which it is done."""
        return self.began + START + (self.state.part.work - self.kept) / speed


@dataclass(frozen=True)
class Simulated:
    """Seconds until all scenes are done, the bound, and the number of machines lost by then."""

    seconds: float
    bound: float
    lost: int


def simulate(scenes: Sequence[float], world: World) -> Simulated:
    """Simulate how the scheduler assigns scenes; `scenes`: seconds of each.

    Raises:
        ValueError: all machines are lost before the end.
    """
    return _Simulation(scenes, world).run()


class _Simulation:
    def __init__(self, scenes: Sequence[float], world: World) -> None:
        self._scenes, self._moves = scenes, world.moves
        self._rng = random.Random(world.seed)
        machines = range(world.machines)
        self._speed = [1 / SLOWNESS if self._rng.random() < world.slow else 1.0 for _ in machines]
        lost = world.lost / HOUR
        self._ends = [self._rng.expovariate(lost) if lost else 1e18 for _ in machines]
        self._states = [_state(index, seconds) for index, seconds in enumerate(scenes)]
        self._after = {state.part.key: 0.0 for state in self._states}
        self._given: list[Given] = []
        self._slow: set[int] = set()
        self._now = 0.0

    def run(self) -> Simulated:
        while any(state.state != DONE for state in self._states):
            self._start()
            if self._moves:
                self._move()
            self._wait()
        lost = sum(end < self._now for end in self._ends)
        bound = _bound(self._scenes, self._speed, self._ends)
        return Simulated(seconds=self._now, bound=bound, lost=lost)

    def _ready(self) -> list[PartState]:
        waiting = [state for state in self._states if state.state == WAITING]
        return sorted(waiting, key=lambda state: -state.left)

    def _free(self) -> list[int]:
        """Machines without a part; slow ones only if there are no others."""
        there = {machine for machine, end in enumerate(self._ends) if end > self._now}
        if not there:
            raise ValueError("all machines are lost")
        return sorted((there - self._slow or there) - {given.machine for given in self._given})

    def _start(self) -> None:
        free = self._free()
        self._rng.shuffle(free)
        for state, machine in zip(self._ready(), free, strict=False):
            state.state, state.started = RUNNING, self._now
            state.first = (self._now + START, state.kept)
            kept = state.kept * state.part.work
            self._given.append(Given(state=state, machine=machine, began=self._now, kept=kept))

    def _move(self) -> None:
        for given in self._given:
            done = given.done(self._now, self._speed[given.machine])
            given.state.progress = {"stage": "joint", "step": done, "total": given.state.part.work}
        idle = bool(self._free())
        found = next_move(self._states, self._after, self._ready(), self._now, idle=idle)
        if found is None:
            return
        given = next(given for given in self._given if given.state is found.state)
        self._given.remove(given)
        if found.slow:
            found.state.avoid = (str(given.machine),)
            self._slow.add(given.machine)
        found.state.made_way = found.state.made_way or not found.slow
        self._stop(found.state, share(found.state))
        self._start()

    def _stop(self, state: PartState, kept: float) -> None:
        state.state, state.kept, state.first, state.progress = WAITING, kept, (0.0, 0.0), {}

    def _wait(self) -> None:
        """Advance to the next end of a part, or to the scheduler's next check if parts may move."""
        ends = [self._end(given) for given in self._given]
        self._now = min([*ends, self._now + LOOK if self._moves else 1e18])
        for given, end in zip(list(self._given), ends, strict=True):
            if end > self._now:
                continue
            self._given.remove(given)
            speed = self._speed[given.machine]
            if given.ends(speed) <= end:
                given.state.state, given.state.seconds = DONE, end - given.began
                continue
            saved = end - self._rng.uniform(0, CHECKPOINT_SECONDS)
            self._stop(given.state, given.done(saved, speed) / given.state.part.work)

    def _end(self, given: Given) -> float:
        """The time at which a part ends, or its machine is lost."""
        return min(given.ends(self._speed[given.machine]), self._ends[given.machine])


def _state(index: int, seconds: float) -> PartState:
    stages = (("joint", seconds),)
    part = Part(scene=str(index), name="all", argv=(), work=seconds, stages=stages)
    return PartState(part=part)


def _bound(scenes: Sequence[float], speed: Sequence[float], ends: Sequence[float]) -> float:
    """A lower bound of the time: the work divided freely, but no less than the longest scene."""
    left, before = sum(scenes), 0.0
    for end in sorted(ends):
        rate = sum(speed[other] for other in range(len(ends)) if ends[other] > before)
        if left <= rate * (end - before):
            return max(before + left / rate, max(scenes))
        left, before = left - rate * (end - before), end
    raise ValueError("all machines are lost")


def scene_seconds(batch: Path) -> list[float]:
    """Training seconds of each finished scene of a batch."""
    found = []
    for scene in sorted(path.parent for path in batch.glob("*/result.ply")):
        records = [read_record(path) for path in sorted(scene.glob(f"{STAGES}/*/{STAGE}"))]
        found.append(sum(record.seconds for record in records if record is not None))
    return found


def main() -> None:
    """Simulate, print and write the table and the plot."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("batch", type=Path)
    parser.add_argument("--objects", type=int, default=200)
    parser.add_argument("--machines", type=int, nargs="+", default=[10, 20, 50, 100])
    parser.add_argument("--seconds", type=float, help="scale the mean scene to so many seconds")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path())
    args = parser.parse_args()
    measured = scene_seconds(args.batch)
    if not measured:
        parser.error(f"{args.batch} has no finished scene.")
    rng = random.Random(0)
    scenes = [rng.choice(measured) * rng.uniform(0.5, 1.5) for _ in range(args.objects)]
    if args.seconds:
        factor = args.seconds * len(scenes) / sum(scenes)
        scenes = [seconds * factor for seconds in scenes]
    rows, ratios = [], {}
    for machines in args.machines:
        runs = [simulate(scenes, World(machines, seed=seed)) for seed in range(args.seeds)]
        ratios[machines] = sorted(run.seconds / run.bound for run in runs)
        middle = sorted(runs, key=lambda run: run.seconds / run.bound)[len(runs) // 2]
        rows.append(
            (
                str(machines),
                str(args.objects),
                str(middle.lost),
                f"{middle.seconds / HOUR:.2f}",
                f"{middle.bound / HOUR:.2f}",
                f"{middle.seconds / middle.bound:.2f}",
                f"{ratios[machines][-1]:.2f}",
            )
        )
    text = "\n".join(table(HEAD, rows, names=0))
    print(text)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "cluster_model.md").write_text(text + "\n", encoding="utf-8")
    _plot(ratios, args.out / "cluster_model.png")


def _plot(ratios: dict[int, list[float]], path: Path) -> None:
    """Plot time / bound against the number of machines, if matplotlib is installed."""
    try:
        import matplotlib
    except ImportError:
        return
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4), layout="constrained")
    counts = sorted(ratios)
    middle = [ratios[count][len(ratios[count]) // 2] for count in counts]
    axes.plot(counts, middle, "o-", label="median of the seeds")
    axes.fill_between(
        counts, [ratios[c][0] for c in counts], [ratios[c][-1] for c in counts], alpha=0.2
    )
    axes.axhline(1.0, color="grey", linewidth=1)
    axes.set_xlabel("machines")
    axes.set_ylabel("time / bound")
    axes.legend()
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()
