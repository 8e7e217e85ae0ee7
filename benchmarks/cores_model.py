"""A model of the training step on more cores: `python -m benchmarks.cores_model FILE`.

FILE is what `python -m benchmarks.step --threads 1 2` has printed on an idle machine. The model is
not a measurement. Its assumptions:

* Of each stage, one core does `2 x wall - CPU` of the two-thread row alone; the rest of the
  one-thread row's time is divided into as many equal tasks as the kernels make of it.
* A core that is free takes the next task; slow cores take longer for it. What one core does alone
  runs on a fast one.
* The cores have caches of their own and disturb each other only in memory: a stage takes at least
  the time in which its bytes (`traffic.py`, as if caches held nothing) pass the memory.
"""

from __future__ import annotations

import argparse
import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.markdown import table
from benchmarks.results import CPU, STAGES, WALL
from benchmarks.traffic import View, stage_bytes

KERNEL_STAGES = STAGES[:-2]
CHIPS: dict[str, tuple[float, ...]] = {
    **{f"{n} equal cores": (1.0,) * n for n in (2, 4, 8, 16)},
    "8 fast, 8 half as fast": (1.0,) * 8 + (0.5,) * 8,
}
"""Name -> speed of each core, in those that were measured."""

CHUNK, PART, TILE, BAND = 1024, 8192, 16, 32  # view.h, binning.cpp, tile.h, loss.cpp
BORDER_ROWS = 20  # a border between two bands of the loss costs as much as so many rows: measured

Times = dict[str, tuple[float, float]]
"""Stage -> milliseconds of wall-clock and of CPU time."""


@dataclass(frozen=True)
class Step:
    """A measured step.

    Attributes:
        name: of its row.
        view: what it does.
        height: of the picture.
        one, two: times on one and on two threads.
    """

    name: str
    view: View
    height: int
    one: Times
    two: Times

    def alone(self, stage: str) -> float:
        """Milliseconds of a stage in which one core works."""
        work = self.one[stage][CPU]
        if stage not in KERNEL_STAGES:
            return work
        return min(work, max(0.0, 2 * self.two[stage][WALL] - self.two[stage][CPU]))

    def tasks(self, stage: str, cores: int) -> int:
        """Into how many tasks the kernels divide a stage."""
        if stage == "bin":
            return max(1, min(cores, int(self.view.visible) // PART))
        if stage == "loss":
            return 3 * self._bands(cores)
        if stage in ("raster", "raster backward"):
            return round(self.view.pixels / TILE**2)
        return -(-int(self.view.gaussians) // CHUNK)

    def shared(self, stage: str, cores: int) -> float:
        """Milliseconds of one core's work that the tasks of a stage are together."""
        work = max(0.0, self.one[stage][CPU] - self.alone(stage))
        if stage == "loss":
            work *= 1 + BORDER_ROWS * (self._bands(cores) - 1) / self.height
        return work

    def _bands(self, cores: int) -> int:
        return max(1, min(cores, self.height // BAND))


@dataclass(frozen=True)
class Modelled:
    """A stage on a chip: milliseconds by arithmetic, and those that its bytes take."""

    arithmetic: float
    memory: float

    @property
    def time(self) -> float:
        """The longer one."""
        return max(self.arithmetic, self.memory)


def makespan(tasks: int, duration: float, speeds: Sequence[float]) -> float:
    """When the last of equal tasks ends, each taken by the core that is free first."""
    free = [(0.0, 1 / speed) for speed in sorted(speeds, reverse=True)]
    end = 0.0
    for _ in range(tasks):
        at, slowness = free[0]
        at += duration * slowness
        heapq.heapreplace(free, (at, slowness))
        end = max(end, at)
    return end


def modelled(step: Step, speeds: Sequence[float], bandwidth: float = 0.0) -> dict[str, Modelled]:
    """Stage -> its time on cores of such speeds; `bandwidth` in GB/s, 0: without limit."""
    moved = stage_bytes(step.view)
    found = {}
    for stage in (*KERNEL_STAGES, "rest"):
        alone = step.alone(stage) / max(speeds)
        memory = 0.0
        if stage in KERNEL_STAGES:
            tasks = step.tasks(stage, len(speeds))
            alone += makespan(tasks, step.shared(stage, len(speeds)) / tasks, speeds)
            memory = 1e-6 * sum(moved[stage]) / bandwidth if bandwidth else 0.0
        found[stage] = Modelled(alone, memory)
    return found


def serial_table(steps: Sequence[Step]) -> list[str]:
    """Of each stage, the milliseconds in which one core works alone; of the step, the share."""
    head = ["step", *KERNEL_STAGES, "rest", "together", "share of the step"]
    rows = []
    for step in steps:
        alone = [step.alone(stage) for stage in (*KERNEL_STAGES, "rest")]
        share = sum(alone) / sum(step.one[stage][CPU] for stage in (*KERNEL_STAGES, "rest"))
        cells = [f"{time:.2f}" for time in (*alone, sum(alone))]
        rows.append([step.name, *cells, f"{100 * share:.1f} %"])
    return table(head, rows, names=1)


def chip_table(steps: Sequence[Step], bandwidths: Sequence[float]) -> list[str]:
    """Milliseconds of a step on each chip, and how many times as fast as on one core."""
    limits = [f"at {bandwidth:g} GB/s" for bandwidth in bandwidths]
    head = ["step", "chip", "ms", "speed-up", *limits, "limited by memory there"]
    rows = []
    for step in steps:
        single = sum(m.time for m in modelled(step, (1.0,)).values())
        for name, speeds in CHIPS.items():
            free = sum(m.time for m in modelled(step, speeds).values())
            limited = [modelled(step, speeds, bandwidth) for bandwidth in bandwidths]
            cells = [f"{sum(m.time for m in one.values()):.2f}" for one in limited]
            last = limited[-1] if limited else {}
            waits = [stage for stage, m in last.items() if m.memory > m.arithmetic]
            rows.append(
                [step.name, name, f"{free:.2f}", f"{single / free:.1f}", *cells, ", ".join(waits)]
            )
    return table(head, rows, names=2)


def bytes_table(steps: Sequence[Step]) -> list[str]:
    """Of each stage, bytes read and written per visible Gaussian; GB/s of one thread."""
    rows = []
    for step in steps:
        for stage, (read, written) in stage_bytes(step.view).items():
            per = (read / step.view.visible, written / step.view.visible)
            rate = 1e-6 * (read + written) / step.one[stage][CPU]
            cells = [*(f"{part:,.0f}" for part in per), f"{rate:.1f}"]
            rows.append([step.name, stage, *cells])
    head = ["step", "stage", "bytes read", "bytes written", "GB/s, one thread"]
    return table(head, rows, names=2)


def read_steps(text: str) -> list[Step]:
    """The rows of the tables of `benchmarks.step` that are there for one thread and for two."""
    times: dict[tuple[str, str], dict[str, Times]] = {}
    views: dict[tuple[str, str], tuple[float, float]] = {}
    for cells in _rows(text):
        key = cells.get("Gaussians", ""), cells.get("size", "")
        if "update" in cells and "(" in cells["update"]:
            found = times.setdefault(key, {})
            found.setdefault(cells["threads"], {s: _wall_cpu(cells[s]) for s in STAGES})
        elif "visible" in cells and "intersections" in cells:
            views.setdefault(key, (_number(cells["visible"]), _number(cells["intersections"])))
    steps = []
    for key, by_threads in times.items():
        if key in views and {"1", "2"} <= by_threads.keys():
            width, height = (int(side) for side in key[1].split(" × "))
            view = View(_number(key[0]), *views[key], width * height)
            name = f"{key[0]}, {key[1]}"
            steps.append(Step(name, view, height, by_threads["1"], by_threads["2"]))
    return steps


def _rows(text: str) -> Iterator[dict[str, str]]:
    """The rows of all Markdown tables: heading -> cell."""
    head: list[str] = []
    for line in text.splitlines():
        if not line.startswith("|"):
            head = []
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not head:
            head = cells
        elif set(line) - set("|-: "):
            yield dict(zip(head, cells, strict=False))


def _wall_cpu(cell: str) -> tuple[float, float]:
    wall, cpu = cell.rstrip(")").split(" (")
    return float(wall), float(cpu)


def _number(cell: str) -> float:
    return float(cell.replace(",", ""))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the three tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("file", type=Path, help="what `benchmarks.step` has printed")
    parser.add_argument(
        "--bandwidth", type=float, nargs="*", default=[], help="of the chip's memory, GB/s"
    )
    options = parser.parse_args(arguments)
    steps = read_steps(options.file.read_text(encoding="utf-8"))
    if not steps:
        parser.error(
            f"{options.file} has no step that was measured on one thread and on two.\n"
            "Save what `python -m benchmarks.step --threads 1 2` prints."
        )
    for title, lines in (
        ("One core alone, milliseconds", serial_table(steps)),
        ("Model of a step, milliseconds", chip_table(steps, options.bandwidth)),
        ("Bytes per visible Gaussian", bytes_table(steps)),
    ):
        print(f"\n{title}:\n\n" + "\n".join(lines))


if __name__ == "__main__":
    main()
