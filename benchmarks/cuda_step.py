"""Time of a training step on an NVIDIA GPU, compared with a bare one; `step --device cuda`.

The bare step is what gsplat's own trainer does for a photo: `gsplat.rasterization`, L1 and SSIM,
and torch's fused Adam over all Gaussians, on the same scene. The two take turns, round by round.
"""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

import torch
from torch import Tensor

from benchmarks.markdown import NONE
from benchmarks.markdown import table as markdown_table
from benchmarks.synthetic import SyntheticPhotos, trainable
from roigs_engine.training.loop import StepsAhead
from roigs_engine.training.losses import photo_loss
from roigs_engine.training.optimizer import VisibleAdam

WARM_UP = 3  # passes over the cameras: kernels are compiled, memory is allocated
COLUMNS = ("Gaussians", "size", "step", "bare step", "bare / step", "in kernels", "waits", "GiB")

Step = Callable[[Tensor], None]
"""A training step as a function of the camera's pose (4, 4)."""


@dataclass(kw_only=True)
class Row:
    """Measurements for one number of Gaussians and one size.

    Attributes:
        gaussians, size: number of Gaussians; size of the photo.
        ours, bare: milliseconds per step, mean over the cameras; one entry per round.
        kernels: share of the step's time in which a kernel ran.
        waits: how often a step waits for the GPU.
        memory: most bytes allocated.
    """

    gaussians: int
    size: tuple[int, int]
    ours: list[float] = field(default_factory=list)
    bare: list[float] = field(default_factory=list)
    kernels: float | None = None
    waits: int | None = None
    memory: int = 0

    def cells(self) -> list[str]:
        """The table's row."""
        step = statistics.median(self.ours)
        bare = statistics.median(self.bare) if self.bare else None
        ratios = [b / o for b, o in zip(self.bare, self.ours, strict=False)]
        return [
            f"{self.gaussians:,}",
            f"{self.size[0]}x{self.size[1]}",
            f"{step:.2f}",
            NONE if bare is None else f"{bare:.2f}",
            f"{statistics.median(ratios):.2f}" if ratios else NONE,
            NONE if self.kernels is None else f"{self.kernels:.0%}",
            NONE if self.waits is None else str(self.waits),
            f"{self.memory / 2**30:.1f}",
        ]


def our_step(gaussians: int, photos: SyntheticPhotos) -> Step:
    """Make a step of the engine."""
    model = trainable(gaussians, photos.photo.device)
    rates = {name: (tensor, 0.0) for name, tensor in model.tensors().items()}
    optimizer = VisibleAdam(rates)
    ahead, taken = StepsAhead(photos.photo.device), 0

    def step(pose: Tensor) -> None:
        nonlocal taken
        ahead.begin(taken, pose)  # without a running loss
        backward_step = ahead.backward_step(optimizer, taken, pose.data_ptr())
        output = photos.render(model, pose, backward_step=backward_step)
        photo_loss(output.image, photos.photo).loss.backward()  # type: ignore[no-untyped-call]
        if ahead.first_void(wait=False):
            raise RuntimeError("The model stays as it is, so its views have as many pairs.")
        taken += 1

    return step


def bare_step(gaussians: int, photos: SyntheticPhotos) -> Step:
    """Make the same step with gsplat's high-level call and torch's optimizer."""
    import gsplat

    model = trainable(gaussians, photos.photo.device)
    groups = [{"params": [tensor], "lr": 0.0} for tensor in model.tensors().values()]
    optimizer = torch.optim.Adam(groups, eps=1e-15, fused=True)
    width, height = photos.size

    def step(pose: Tensor) -> None:
        image, _, _ = gsplat.rasterization(
            means=model.means,
            quats=model.quats,
            scales=model.log_scales.exp(),
            opacities=model.logit_opacities.sigmoid(),
            colors=model.sh,
            viewmats=pose[None],
            Ks=photos.intrinsics,
            width=width,
            height=height,
            sh_degree=3,
            packed=False,
        )
        photo_loss(image, photos.photo).loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)

    return step


def measure(
    gaussians: int,
    size: tuple[int, int],
    rounds: int,
    device: torch.device,
    makers: Sequence[Callable[[int, SyntheticPhotos], Step]] | None = None,
) -> Row:
    """Measure a row; `makers`: compared steps, ours first; None: ours, and gsplat if installed."""
    if makers is None:
        bare = [bare_step] if find_spec("gsplat") else []
        makers = (our_step, *bare)
    row, photos = Row(gaussians=gaussians, size=size), SyntheticPhotos(size, device)
    steps = [make(gaussians, photos) for make in makers]
    for step in steps:
        for _ in range(WARM_UP):
            _pass(step, photos)
    for _ in range(rounds):
        for times, step in zip((row.ours, row.bare), steps, strict=False):
            times.append(_pass(step, photos))
    if device.type == "cuda":
        row.memory = torch.cuda.max_memory_allocated(device)
        with suppress(RuntimeError):  # the times are useful without them
            row.waits = _waits(steps[0], photos)
            row.kernels = _share_in_kernels(steps[0], photos)
    return row


def table(rows: Sequence[Row]) -> str:
    """Markdown."""
    return "\n".join(markdown_table(COLUMNS, (row.cells() for row in rows)))


def _pass(step: Step, photos: SyntheticPhotos) -> float:
    """Milliseconds per step in a pass over all cameras, until the device has finished."""
    _settle(photos)
    began = time.perf_counter()
    for pose in photos.poses:
        step(pose)
    _settle(photos)
    return 1e3 * (time.perf_counter() - began) / len(photos.poses)


def _settle(photos: SyntheticPhotos) -> None:
    if photos.photo.is_cuda:
        torch.cuda.synchronize()


def _waits(step: Step, photos: SyntheticPhotos) -> int:
    """How often one step makes the CPU wait for the GPU."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            step(photos.poses[0])
        finally:
            torch.cuda.set_sync_debug_mode("default")
    return sum("synchroniz" in str(warning.message) for warning in caught)


def _share_in_kernels(step: Step, photos: SyntheticPhotos) -> float:
    """Share of a pass's time in kernels, which run one after the other."""
    whole = _pass(step, photos) * len(photos.poses)
    from torch.profiler import ProfilerActivity, profile

    with profile(activities=[ProfilerActivity.CUDA]) as profiler:
        _pass(step, photos)
    events: Any = profiler.key_averages()
    return float(sum(event.self_device_time_total for event in events)) / 1e3 / whole
