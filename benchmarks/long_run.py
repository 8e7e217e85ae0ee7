"""Hours of training in one process: `python -m benchmarks.long_run FOLDER --hours 2` (Linux).

The demo scene is trained with growing Gaussians, again and again. Every cycle begins at the sparse
points, in a stage folder of its own, with photos, checkpoints and previews as a run has them. A
cycle repeats the one before bit for bit, so memory and the time of a step are compared at equal
numbers of Gaussians. A line goes to FOLDER/log.csv every 50 steps: `python -m benchmarks.long_run
FOLDER --evaluate` evaluates it, also while the run is at work or after it was interrupted.

Times are CPU times: the machine may do other work, or pause this process.
"""

from __future__ import annotations

import argparse
import csv
import math
import shutil
import statistics
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

from benchmarks.markdown import table
from benchmarks.memory import resident

SCENE = Path(__file__).resolve().parent.parent / "demo" / "scene"
LOG_STEPS = 50
PREVIEW_SECONDS = 30.0


class Log:
    """Writes a row every `LOG_STEPS` steps; a context's `should_stop` counts the steps."""

    def __init__(self, path: Path) -> None:
        self._file = open(path, "w", encoding="utf-8", newline="")  # noqa: SIM115 - open to the end
        self._rows = csv.writer(self._file)
        self._rows.writerow(["cycle", "step", "gaussians", "clock_s", "cpu_ms", "resident_mib"])
        self._began, self._cpu = time.monotonic(), 0.0
        self._cycle, self._step, self.gaussians = -1, 0, 0

    def begin_cycle(self) -> None:
        """Start to count steps from 0 again."""
        self._cycle, self._step, self._cpu = self._cycle + 1, 0, time.process_time()

    def before_step(self) -> bool:
        """Count a step; called before every step of a stage. False: never stops it."""
        if self._step % LOG_STEPS == 0 and self._step:
            now, cpu = time.monotonic() - self._began, time.process_time()
            spent = 1000 * (cpu - self._cpu) / LOG_STEPS
            row = [self._cycle, self._step, self.gaussians, f"{now:.1f}", f"{spent:.3f}"]
            self._rows.writerow([*row, f"{resident():.1f}"])
            self._file.flush()
            self._cpu = cpu
        self._step += 1
        return False


def train(folder: Path, hours: float, steps: int, threads: int) -> None:
    """Train complete cycles until `hours` of wall-clock time have passed."""
    from benchmarks.training import all_photos
    from roigs_engine.colmap.project import load_colmap
    from roigs_engine.context import Context
    from roigs_engine.formats.events import Event, Progress
    from roigs_engine.kernels import library
    from roigs_engine.model.gaussians import Gaussians
    from roigs_engine.photos.cache import PhotoCache
    from roigs_engine.run.presets import preset
    from roigs_engine.run.stage_folder import StageFolder
    from roigs_engine.training.mechanisms.density_control import DensityControl

    library.set_threads(threads)
    folder.mkdir(parents=True, exist_ok=True)
    scene = load_colmap(SCENE, cache=folder / "cache")
    config = replace(
        preset("standard").scene,
        steps=steps,
        mechanisms=(DensityControl(start=100, until=steps, grad_threshold=4e-4, reset_every=0),),
    )
    log, began = Log(folder / "log.csv"), time.monotonic()

    def watch(event: Event) -> None:
        if isinstance(event, Progress):
            log.gaussians = event.gaussians

    context = Context(emit=watch, should_stop=log.before_step)
    stage = StageFolder(
        name="stage",
        folder=folder / "stage",
        fingerprint="long run",
        preview=folder / "preview.ply",
        preview_seconds=PREVIEW_SECONDS,
    )
    while time.monotonic() - began < 3600 * hours:
        log.begin_cycle()
        shutil.rmtree(stage.folder, ignore_errors=True)
        with PhotoCache(scene.images) as cache:
            stage.train(
                lambda: Gaussians.from_points(scene.points, scene.colors),
                all_photos(scene.images, scene.extent(), cache),
                config,
                context,
            )


def evaluate(folder: Path) -> None:
    """Compare the cycles with the second one (number 1); the first warms up the allocator."""
    cycles: dict[int, dict[int, dict[str, float]]] = defaultdict(dict)
    with open(folder / "log.csv", encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            values = {name: float(value) for name, value in row.items()}
            cycles[int(row["cycle"])][int(row["step"])] = values
    minutes = max(row["clock_s"] for row in cycles[max(cycles)].values()) / 60
    print(f"{len(cycles)} cycles in {minutes:.0f} minutes\n")
    head = ["cycle", "steps", "Gaussians", "CPU ms a step", "of cycle 1", "MiB", "of cycle 1"]
    lines = []
    for cycle, rows in cycles.items():
        cells = [str(cycle), str(max(rows)), f"{rows[max(rows)]['gaussians']:,.0f}"]
        for field in ("cpu_ms", "resident_mib"):
            cells.append(f"{statistics.median(row[field] for row in rows.values()):.1f}")
            shared = rows.keys() & cycles.get(1, {}).keys()
            ratios = [100 * rows[s][field] / cycles[1][s][field] for s in shared] or [math.nan]
            middle = statistics.median(ratios)
            cells.append(f"{middle:.1f} % ({min(ratios):.1f} to {max(ratios):.1f})")
        lines.append(cells)
    print("\n".join(table(head, lines)))


def main() -> None:
    """Train, or evaluate the log."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--steps", type=int, default=2500, help="of a cycle")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--evaluate", action="store_true")
    args = parser.parse_args()
    if not args.evaluate:
        train(args.folder, args.hours, args.steps, args.threads)
    evaluate(args.folder)


if __name__ == "__main__":
    main()
