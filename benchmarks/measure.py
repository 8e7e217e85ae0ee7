"""Times training steps stage by stage, on the synthetic scene, in this process."""

from __future__ import annotations

import inspect
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from typing import Any

import torch

from benchmarks.memory import MIB, resident
from benchmarks.synthetic import CAMERAS, SyntheticPhotos, trainable
from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize.cpu import KernelView
from roigs_engine.training.losses import photo_loss
from roigs_engine.training.optimizer import VisibleAdam

KERNEL_STAGES = {
    "roigs_project": "project",
    "roigs_bin": "bin",
    "roigs_render": "raster",
    "roigs_median_depth": "raster",
    "roigs_render_backward": "raster backward",
    "roigs_project_backward": "update",
    "roigs_project_backward_adam": "update",
}
"""Kernel -> stage, for kernels that run inside one torch function."""

COUNTS = {
    "roigs_project": "visible",
    "roigs_bin": "intersections",
    "roigs_pair_evaluations": "pairs",
}
"""Kernel -> what its result counts."""

Times = dict[str, tuple[float, float]]
"""Stage -> milliseconds of wall-clock time, and of process-CPU time."""

Through = Callable[[KernelView, str, Callable[[], int]], int]
"""Takes the view, a kernel's name and its call; returns the call's result."""


class Stopwatch:
    """Adds up the times of stages in `taken`."""

    def __init__(self) -> None:
        self.taken: Times = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the duration of the context."""
        wall, cpu = time.perf_counter(), time.process_time()
        yield
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        before = self.taken.get(name, (0.0, 0.0))
        self.taken[name] = before[0] + 1e3 * wall, before[1] + 1e3 * cpu

    def kernel(self, view: KernelView, name: str, call: Callable[[], int]) -> int:
        """Time a kernel of the rasterizer; for `kernel_calls`."""
        with self.stage(KERNEL_STAGES.get(name, name)):
            return call()


@contextmanager
def kernel_calls(through: Through) -> Iterator[None]:
    """Within the context, call the rasterizer's kernels by `through`."""
    original = KernelView.call

    def call(view: KernelView, name: str, *arguments: Any) -> int:
        return through(view, name, lambda: original(view, name, *arguments))

    KernelView.call = call  # type: ignore[assignment,method-assign]
    try:
        yield
    finally:
        KernelView.call = original  # type: ignore[method-assign]


class StepBenchmark:
    """A model, its optimizer (learning rate 0, so that every pass is the same work), and photos."""

    def __init__(self, gaussians: int, width: int, height: int) -> None:
        self.model = trainable(gaussians)
        parameters = {name: (tensor, 0.0) for name, tensor in self.model.tensors().items()}
        self.optimizer = VisibleAdam(parameters)
        self.photos = SyntheticPhotos((width, height))
        self.passes = 0

    def counts(self) -> dict[str, list[int]]:
        """Name of a count -> the number for each camera."""
        found: dict[str, list[int]] = {}

        def count(view: KernelView, name: str, call: Callable[[], int]) -> int:
            result = call()
            if name in COUNTS:
                found.setdefault(COUNTS[name], []).append(result)
            if name == "roigs_render":
                view.call("roigs_pair_evaluations")
            return result

        with kernel_calls(count), torch.no_grad():
            for pose in self.photos.poses:
                self.photos.render(self.model, pose)
        return found

    def step_times(self) -> list[Times]:
        """Time a training step for each camera; "rest" is the time outside all other stages."""
        return [self._step(pose) for pose in self.photos.poses]

    def extras_times(self) -> list[dict[str, Times]]:
        """For each camera: set of optional outputs -> times of one render without gradient.

        The order of the sets changes with camera and pass.
        """
        options = list(optional_outputs().items())
        found = []
        for c, pose in enumerate(self.photos.poses):
            first = (self.passes * CAMERAS + c) % len(options)
            found.append({n: self._render_times(pose, o) for n, o in _rotated(options, first)})
        self.passes += 1
        return found

    def _step(self, pose: torch.Tensor) -> Times:
        watch = Stopwatch()
        with kernel_calls(watch.kernel), watch.stage("step"):
            step = self.optimizer.backward_step
            output = self.photos.render(self.model, pose, backward_step=step)
            with watch.stage("loss"):
                loss = photo_loss(output.image, self.photos.photo)
            loss.loss.backward()  # type: ignore[no-untyped-call]
        stages = [times for name, times in watch.taken.items() if name != "step"]
        wall, cpu = (
            whole - sum(parts)
            for whole, parts in zip(watch.taken["step"], zip(*stages, strict=True), strict=True)
        )
        return {**watch.taken, "rest": (wall, cpu)}

    def _render_times(self, pose: torch.Tensor, options: dict[str, Any]) -> Times:
        watch = Stopwatch()
        with kernel_calls(watch.kernel), watch.stage("render"), torch.no_grad():
            self.photos.render(self.model, pose, **options)
        return watch.taken


def optional_outputs() -> dict[str, dict[str, Any]]:
    """Name -> arguments of `rasterize`, for every set of optional outputs, from none to all.

    The median depth occurs only alone.
    """
    names = [name for name in inspect.signature(rasterize).parameters if name.startswith("with_")]
    sets = [chosen for n in range(len(names) + 1) for chosen in combinations(names, n)]
    found: dict[str, dict[str, Any]] = {
        " + ".join(name.removeprefix("with_") for name in chosen) or "plain": dict.fromkeys(
            chosen, True
        )
        for chosen in sets
    }
    return {**found, "median depth": {"with_depth": "median"}}


def forget_peak_memory() -> None:
    """Restart `peak_memory` from here, if the system supports it (Linux)."""
    if sys.platform == "linux":
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory() -> int | None:
    """Peak resident memory of this process, bytes; None if it is unknown (Windows)."""
    if sys.platform == "linux":
        return round(resident("VmHWM") * MIB)
    if sys.platform == "darwin":
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return None


def _rotated(items: list[Any], first: int) -> list[Any]:
    return items[first:] + items[:first]
