"""How long a batch takes on many machines, some of which are slow and some are lost: a simulation.

    python -m benchmarks.cluster_model BATCH [--objects 200] [--machines 10 100] [--out DIR]

BATCH is the folder of a finished batch (`--run-dir`), whose scenes' stage times are drawn from. The
machines are equal but for stragglers. Parts are given out as `roigs_engine.batch.schedule` does;
one whose machine is lost goes on elsewhere from its last checkpoint. The bound is the time in which
the machines that are left at each moment can do all the work, or that the longest scene takes.
Writes `cluster_model.md` and, with matplotlib (the extra `study`), `cluster_model.png`.
"""

from __future__ import annotations

import argparse
import heapq
import random
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.markdown import table
from roigs_engine.batch.schedule import SLOW, WORTH_MOVING
from roigs_engine.batch.times import START
from roigs_engine.formats.run_files import STAGE
from roigs_engine.run.stage_folder import CHECKPOINT_SECONDS
from roigs_engine.run.stage_record import read_record

HOUR = 3600.0
PERCENT_LOST, SLOW_SHARE, SLOWNESS = 5.0, 0.05, 3.0
HEAD = ("machines", "objects", "lost", "hours", "bound, h", "hours / bound", "worst of seeds")


@dataclass(frozen=True)
class World:
    """What the simulated machines are like.

    Attributes:
        machines: their number.
        lost: share of them that is lost per hour.
        slow: share of stragglers, which take `SLOWNESS` times as long.
        seed: of which, and when.
        moves: whether parts of stragglers are moved to idle machines.
    """

    machines: int
    lost: float = PERCENT_LOST / 100
    slow: float = SLOW_SHARE
    seed: int = 0
    moves: bool = True


@dataclass(frozen=True, order=True)
class Given:
    """A part at work: when it ends, where, seconds left after that, when it began."""

    ends: float
    machine: int
    left: float
    began: float


@dataclass(frozen=True)
class Simulated:
    """Seconds until all scenes are done, the bound, and the number of machines lost by then."""

    seconds: float
    bound: float
    lost: int


def simulate(scenes: Sequence[float], world: World) -> Simulated:
    """Give out scenes, of so many seconds each, the longest first.

    Raises:
        ValueError: all machines are lost before the end.
    """
    rng = random.Random(world.seed)
    speed = [1 / SLOWNESS if rng.random() < world.slow else 1.0 for _ in range(world.machines)]
    ends = [rng.expovariate(world.lost / HOUR) if world.lost else 1e18 for _ in speed]
    waiting = [-(seconds + START) for seconds in scenes]
    heapq.heapify(waiting)
    free = set(range(world.machines))
    running: list[Given] = []
    now = 0.0
    while waiting or running:
        free = {machine for machine in free if ends[machine] > now}
        while waiting and free:
            seconds = -heapq.heappop(waiting)
            free.remove(machine := rng.choice(sorted(free)))
            running.append(_given(machine, seconds, now, speed, ends, rng))
        if world.moves and free and not waiting:
            _move(running, waiting, free, now, speed)
            if waiting:
                continue
        if not running:
            raise ValueError("all machines are lost")
        first = min(running)
        running.remove(first)
        now = first.ends
        if first.left > 0:
            heapq.heappush(waiting, -first.left)
        else:
            free.add(first.machine)
    lost = sum(end < now for end in ends)
    return Simulated(seconds=now, bound=_bound(scenes, speed, ends), lost=lost)


def _move(
    running: list[Given],
    waiting: list[float],
    free: set[int],
    now: float,
    speed: Sequence[float],
) -> None:
    """Stop the slow part that would end last, as `schedule.straggler` does."""
    slow = [
        given
        for given in running
        if speed[given.machine] < 1 / SLOW
        and given.began + START < now
        and given.ends - now > WORTH_MOVING
    ]
    if slow:
        last = max(slow)
        running.remove(last)
        free.discard(last.machine)  # so that the part avoids it; it stays idle
        left = (last.ends - now) * speed[last.machine] + START
        heapq.heappush(waiting, -left)


def _given(
    machine: int,
    seconds: float,
    now: float,
    speed: Sequence[float],
    ends: Sequence[float],
    rng: random.Random,
) -> Given:
    """A part on a machine: when that ends, and what is then left to do."""
    done = now + seconds / speed[machine]
    if done <= ends[machine]:
        return Given(done, machine, 0.0, now)
    saved = max(0.0, ends[machine] - now - rng.uniform(0, CHECKPOINT_SECONDS)) * speed[machine]
    return Given(ends[machine], machine, min(seconds, seconds - saved + START), now)


def _bound(scenes: Sequence[float], speed: Sequence[float], ends: Sequence[float]) -> float:
    """Seconds in which the machines can do all the work, had it no parts."""
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
        records = [read_record(path) for path in sorted(scene.glob(f"*/{STAGE}"))]
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
    """The time over its bound against the number of machines, if matplotlib is there."""
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
