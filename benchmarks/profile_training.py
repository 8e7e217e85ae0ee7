"""Profile of a training: `python -m benchmarks.profile_training SCENE`.

Trains the Full Scene baseline of a preset and measures the time of the training thread: in the
compiled kernels, and in each part of the Python around them. A part's time leaves out the parts and
the kernels that it calls. No checkpoints are written: they are not training.
"""

from __future__ import annotations

import argparse
import ctypes
import functools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from benchmarks.markdown import table
from benchmarks.training import all_photos
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import Context
from roigs_engine.kernels import bindings, library
from roigs_engine.machine import usable_cores
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.run.presets import PRESETS, preset
from roigs_engine.run.stage_configs import baseline
from roigs_engine.training import trainer
from roigs_engine.training.mechanisms.density_control import RunningDensityControl
from roigs_engine.training.metrics import TrainingMetrics
from roigs_engine.training.optimizer import VisibleAdam
from roigs_engine.training.trainer import Trainer

KERNELS = "kernels"


class Clock:
    """Adds up the time of nested parts, each without the parts inside it.

    Attributes:
        seconds: part -> [wall-clock time, CPU time of this thread].
    """

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}
        self._taken = [0.0, 0.0]  # times of the running part
        self._since = 0.0, 0.0

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a function so that its time counts for `part`."""
        taken = self.seconds.setdefault(part, [0.0, 0.0])

        @functools.wraps(function)
        def run(*arguments: Any, **options: Any) -> Any:
            outer = self._switch(taken)
            try:
                return function(*arguments, **options)
            finally:
                self._switch(outer)

        return run

    def _switch(self, following: list[float]) -> list[float]:
        """Count time for `following` from now on; returns what it was counted for before."""
        now, before, running = (time.perf_counter(), time.thread_time()), self._since, self._taken
        running[0] += now[0] - before[0]
        running[1] += now[1] - before[1]
        self._since, self._taken = now, following
        return running

    def watch(self, owner: Any, name: str, part: str) -> None:
        """Time a function or method for `part`, wherever it is called."""
        setattr(owner, name, self.timed(part, getattr(owner, name)))


class TimedKernels:
    """The kernels' library; the time of each of its functions is counted."""

    def __init__(self, kernels: ctypes.CDLL, clock: Clock) -> None:
        self._kernels, self._clock = kernels, clock

    def __getattr__(self, name: str) -> Callable[..., Any]:
        function = self._clock.timed(f"{KERNELS}: {name}", getattr(self._kernels, name))
        setattr(self, name, function)
        return function


def watch_training() -> Clock:
    """Time the parts of every training step in this process from now on."""
    clock = Clock()
    kernels = TimedKernels(bindings.kernels(), clock)
    bindings.kernels = lambda: kernels  # type: ignore[assignment]
    clock.watch(Trainer, "_run", "the loop itself")
    clock.watch(PhotoCache, "prefetch", "photos")
    clock.watch(PhotoCache, "__getitem__", "photos")
    clock.watch(trainer, "rasterize", "rasterize")
    clock.watch(trainer, "photo_loss", "loss")
    clock.watch(torch.Tensor, "backward", "backward")
    clock.watch(VisibleAdam, "step", "optimizer")
    clock.watch(VisibleAdam, "step_by", "optimizer")
    clock.watch(VisibleAdam, "set_lr", "optimizer")
    clock.watch(RunningDensityControl, "observe", "statistics")
    clock.watch(TrainingMetrics, "observe", "running loss and PSNR")
    clock.watch(RunningDensityControl, "edit", "densification")
    clock.watch(Trainer, "_apply", "densification")
    return clock


def train(folder: Path, max_side: int, preset_name: str, steps: int) -> Trainer:
    """Train the first steps of the Full Scene baseline on all photos of a COLMAP project."""
    scene = load_colmap(folder, max_side=max_side)
    data = all_photos(scene.images, scene.extent())
    start = Gaussians.from_points(scene.points, scene.colors)
    work = Trainer(start, data, baseline(preset(preset_name)))
    work.run(Context(should_stop=lambda: work.step >= steps))
    return work


def print_table(clock: Clock, steps: int) -> None:
    """Print the parts by time, longest first, and the kernels' share of all."""
    total = [sum(taken[k] for taken in clock.seconds.values()) for k in (0, 1)]
    inside = [
        sum(taken[k] for part, taken in clock.seconds.items() if part.startswith(KERNELS))
        for k in (0, 1)
    ]
    rows = sorted(clock.seconds.items(), key=lambda row: -row[1][0])
    lines = []
    for part, taken in [*rows, ("all kernels", inside), ("all", total)]:
        wall, cpu = (1e3 * t / steps for t in taken)
        share, cpu_share = (100 * taken[k] / total[k] for k in (0, 1))
        lines.append([part, f"{wall:.3f} ({cpu:.3f})", f"{share:.1f} % ({cpu_share:.1f} %)"])
    print("\n".join(table(["part", "ms a step, wall (CPU)", "share, wall (CPU)"], lines)))


def main() -> None:
    """Train, and print one Markdown row per part."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--max-side", type=int, default=640)
    parser.add_argument("--preset", choices=sorted(PRESETS), default="draft")
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--threads", type=int, default=usable_cores())
    args = parser.parse_args()
    library.set_threads(args.threads)
    clock = watch_training()
    work = train(args.scene, args.max_side, args.preset, args.steps)
    print(
        f"{args.scene.name}, {library.isa()}, {args.threads} threads, {work.step} steps, "
        f"{len(work.gaussians):,} Gaussians at the end; time of the training thread"
    )
    print_table(clock, work.step)


if __name__ == "__main__":
    main()
