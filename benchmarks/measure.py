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
from benchmarks.synthetic import CAMERAS, ring_cameras, synthetic_gaussians
from roigs_engine.kernels import library
from roigs_engine.model.gaussians import NAMES
from roigs_engine.rasterize import RenderOutput, rasterize
from roigs_engine.rasterize.cpu import View
from roigs_engine.training.losses import photo_loss
from roigs_engine.training.optimizer import VisibleAdam

KERNEL_STAGES = {
    "roigs_project": "project",
    "roigs_bin": "bin",
    "roigs_render": "raster",
    "roigs_render_backward": "raster backward",
    "roigs_project_backward": "update",
    "roigs_project_backward_adam": "update",
}
"""Kernel -> stage of the kernels that run inside one torch function."""

COUNTS = {
    "roigs_project": "visible",
    "roigs_bin": "intersections",
    "roigs_pair_evaluations": "pairs",
}
"""Kernel -> what its result counts."""

Times = dict[str, tuple[float, float]]
"""Stage -> milliseconds of wall-clock time, and of process-CPU time."""


class Stopwatch:
    """Adds up the times of stages in `taken`."""

    def __init__(self) -> None:
        self.taken: Times = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Adds the time that the context lasts."""
        wall, cpu = time.perf_counter(), time.process_time()
        yield
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        before = self.taken.get(name, (0.0, 0.0))
        self.taken[name] = before[0] + 1e3 * wall, before[1] + 1e3 * cpu

    def kernel(self, view: View, name: str, call: Callable[[], int]) -> int:
        """Times the rasterizer's kernels, for `kernel_calls`."""
        with self.stage(KERNEL_STAGES.get(name, name)):
            return call()


@contextmanager
def kernel_calls(through: Callable[[View, str, Callable[[], int]], int]) -> Iterator[None]:
    """As long as the context lasts, kernels of the rasterizer are called by `through`.

    It gets the view, the kernel's name and the call, whose result it has to return.
    """
    original = View.call

    def call(view: View, name: str, *arguments: Any) -> int:
        return through(view, name, lambda: original(view, name, *arguments))

    View.call = call
    try:
        yield
    finally:
        View.call = original


class StepBenchmark:
    """A model, its optimiser (at learning rate 0: every pass does the same work), and cameras."""

    def __init__(self, gaussians: int, width: int, height: int) -> None:
        model = synthetic_gaussians(gaussians)
        self.tensors = {n: getattr(model, n).requires_grad_() for n in NAMES}
        fused = {"fused": True} if _fuses() else {}
        self.optimizer = VisibleAdam({n: (t, 0.0) for n, t in self.tensors.items()}, **fused)
        self.fused = {"optimizer": self.optimizer} if _fuses() else {}
        focal = 0.87 * width
        self.intrinsics = torch.tensor([[[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]])
        generator = torch.Generator().manual_seed(0)
        self.target = torch.randint(
            0, 256, (height, width, 3), dtype=torch.uint8, generator=generator
        )
        self.poses = ring_cameras()
        self.passes = 0

    def counts(self) -> dict[str, list[int]]:
        """What is counted -> its number for each camera; "pairs" where the engine counts them."""
        found: dict[str, list[int]] = {}
        can_count_pairs = _counts_pairs()

        def count(view: View, name: str, call: Callable[[], int]) -> int:
            result = call()
            if name in COUNTS:
                found.setdefault(COUNTS[name], []).append(result)
            if name == "roigs_render" and can_count_pairs:
                view.call("roigs_pair_evaluations")
            return result

        with kernel_calls(count), torch.no_grad():
            for pose in self.poses:
                self._render(pose)
        return found

    def step_times(self) -> list[Times]:
        """One training step for each camera; "rest" is what of "step" no stage accounts for."""
        return [self._step(pose) for pose in self.poses]

    def extras_times(self) -> list[dict[str, Times]]:
        """For each camera: set of optional outputs -> times of one render without gradient.

        The order in which the sets have their turn changes with camera and pass.
        """
        options = list(optional_outputs().items())
        found = []
        for c, pose in enumerate(self.poses):
            first = (self.passes * CAMERAS + c) % len(options)
            found.append({n: self._render_times(pose, o) for n, o in _rotated(options, first)})
        self.passes += 1
        return found

    def _render(self, pose: torch.Tensor, **options: Any) -> RenderOutput:
        height, width = self.target.shape[:2]
        parameters = self.tensors.values()
        return rasterize(
            *parameters, pose[None], self.intrinsics, width, height, raw=True, **options
        )

    def _step(self, pose: torch.Tensor) -> Times:
        watch = Stopwatch()
        with kernel_calls(watch.kernel), watch.stage("step"):
            output = self._render(pose, **self.fused)
            with watch.stage("loss"):
                loss = photo_loss(output.image, self.target)
            loss.loss.backward()
            if not self.fused:
                with watch.stage("update"):
                    self.optimizer.step(output.visible[0])
        stages = [times for name, times in watch.taken.items() if name != "step"]
        wall, cpu = (
            whole - sum(parts)
            for whole, parts in zip(watch.taken["step"], zip(*stages, strict=True), strict=True)
        )
        return {**watch.taken, "rest": (wall, cpu)}

    def _render_times(self, pose: torch.Tensor, options: dict[str, bool]) -> Times:
        watch = Stopwatch()
        with kernel_calls(watch.kernel), watch.stage("render"), torch.no_grad():
            self._render(pose, **options)
        return watch.taken


def optional_outputs() -> dict[str, dict[str, bool]]:
    """Name -> arguments: no optional output of `rasterize`, each alone, pairs, ..., all."""
    names = [name for name in inspect.signature(rasterize).parameters if name.startswith("with_")]
    sets = [chosen for n in range(len(names) + 1) for chosen in combinations(names, n)]
    return {
        " + ".join(name.removeprefix("with_") for name in chosen) or "plain": dict.fromkeys(
            chosen, True
        )
        for chosen in sets
    }


def forget_peak_memory() -> None:
    """From here on `peak_memory` counts anew, where the system can do that (Linux)."""
    if sys.platform == "linux":
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory() -> int | None:
    """The most bytes this process had resident; None where the system does not say (Windows)."""
    if sys.platform == "linux":
        return round(resident("VmHWM") * MIB)
    if sys.platform == "darwin":
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return None


def _counts_pairs() -> bool:
    """False for a revision of the engine that does not count pairs."""
    return hasattr(library.load(), "roigs_pair_evaluations")


def _fuses() -> bool:
    """False for a revision of the engine whose backward pass takes no step of the optimiser."""
    return "optimizer" in inspect.signature(rasterize).parameters


def _rotated(items: list[Any], first: int) -> list[Any]:
    return items[first:] + items[:first]
