"""How long a training step takes on a card, beside a bare one; `benchmarks.step --device cuda`.

The bare step is what gsplat's own trainer does for a photo: `gsplat.rasterization`, L1 and SSIM,
and torch's fused Adam over all Gaussians, on the same scene. Both take turns, round by round.
"""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from benchmarks.synthetic import ring_cameras, synthetic_gaussians
from roigs_engine.model.gaussians import NAMES
from roigs_engine.rasterize import rasterize
from roigs_engine.training.losses import photo_loss
from roigs_engine.training.optimizer import VisibleAdam

WARM_UP = 3  # passes over the cameras: kernels are compiled, memory is taken
COLUMNS = ("Gaussians", "size", "step", "bare step", "bare / step", "in kernels", "waits", "GiB")


@dataclass(kw_only=True)
class Row:
    """Milliseconds of a pass over the cameras, divided by their number; one entry a round."""

    gaussians: int
    size: tuple[int, int]
    ours: list[float] = field(default_factory=list)
    bare: list[float] = field(default_factory=list)
    kernels: float | None = None  # share of the step's time in which a kernel ran
    waits: int | None = None  # times a step waits for the card
    memory: int = 0  # bytes, the most that was allocated

    def cells(self) -> list[str]:
        """The table's row."""
        step = statistics.median(self.ours)
        bare = statistics.median(self.bare) if self.bare else None
        ratios = [b / o for b, o in zip(self.bare, self.ours, strict=False)]
        return [
            f"{self.gaussians:,}",
            f"{self.size[0]}x{self.size[1]}",
            f"{step:.2f}",
            "-" if bare is None else f"{bare:.2f}",
            f"{statistics.median(ratios):.2f}" if ratios else "-",
            "-" if self.kernels is None else f"{self.kernels:.0%}",
            "-" if self.waits is None else str(self.waits),
            f"{self.memory / 2**30:.1f}",
        ]


class Scene:
    """Cameras and photo on a device."""

    def __init__(self, size: tuple[int, int], device: torch.device) -> None:
        width, height = self.size = size
        focal = 0.87 * width
        self.views = ring_cameras().to(device)
        matrix = [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]
        self.intrinsics = torch.tensor([matrix], device=device)
        generator = torch.Generator().manual_seed(0)
        shape = (height, width, 3)
        photo = torch.randint(0, 256, shape, dtype=torch.uint8, generator=generator)
        self.photo = photo.to(device)


def our_step(gaussians: int, scene: Scene) -> Callable[[Tensor], None]:
    """A step of the engine as a function of the camera's pose (1, 4, 4)."""
    tensors = _tensors(gaussians, scene.photo.device)
    optimizer = VisibleAdam({name: (tensor, 0.0) for name, tensor in tensors.items()})

    def step(pose: Tensor) -> None:
        output = rasterize(*tensors.values(), pose, scene.intrinsics, *scene.size, raw=True)
        photo_loss(output.image, scene.photo).loss.backward()
        optimizer.step(output.visible[0])

    return step


def bare_step(gaussians: int, scene: Scene) -> Callable[[Tensor], None]:
    """The same by gsplat's high-level call and torch's optimiser."""
    import gsplat

    tensors = _tensors(gaussians, scene.photo.device)
    groups = [{"params": [tensor], "lr": 0.0} for tensor in tensors.values()]
    optimizer = torch.optim.Adam(groups, eps=1e-15, fused=True)
    means, quats, scales, opacities, sh = tensors.values()

    def step(pose: Tensor) -> None:
        image, _, _ = gsplat.rasterization(
            means=means,
            quats=quats,
            scales=scales.exp(),
            opacities=opacities.sigmoid(),
            colors=sh,
            viewmats=pose,
            Ks=scene.intrinsics,
            width=scene.size[0],
            height=scene.size[1],
            sh_degree=3,
            packed=False,
        )
        photo_loss(image, scene.photo).loss.backward()
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)

    return step


def measure(
    gaussians: int,
    size: tuple[int, int],
    rounds: int,
    device: torch.device,
    makers: Sequence[Callable[[int, Scene], Callable[[Tensor], None]]] = (our_step, bare_step),
) -> Row:
    """One row; `makers`: what is compared, ours first."""
    row, scene = Row(gaussians=gaussians, size=size), Scene(size, device)
    steps = [make(gaussians, scene) for make in makers]
    for step in steps:
        for _ in range(WARM_UP):
            _pass(step, scene)
    for _ in range(rounds):
        for times, step in zip((row.ours, row.bare), steps, strict=False):
            times.append(_pass(step, scene))
    if device.type == "cuda":
        row.memory = torch.cuda.max_memory_allocated(device)
        row.waits = _waits(steps[0], scene)
        row.kernels = _share_in_kernels(steps[0], scene)
    return row


def table(rows: Sequence[Row]) -> str:
    """Markdown."""
    lines = [COLUMNS, ("---",) * len(COLUMNS), *(row.cells() for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _tensors(gaussians: int, device: torch.device) -> dict[str, Tensor]:
    model = synthetic_gaussians(gaussians)
    return {name: getattr(model, name).to(device).requires_grad_() for name in NAMES}


def _pass(step: Callable[[Tensor], None], scene: Scene) -> float:
    """Milliseconds a step, over all cameras, until the device is done."""
    _settle(scene)
    began = time.perf_counter()
    for c in range(len(scene.views)):
        step(scene.views[c : c + 1])
    _settle(scene)
    return 1e3 * (time.perf_counter() - began) / len(scene.views)


def _settle(scene: Scene) -> None:
    if scene.photo.is_cuda:
        torch.cuda.synchronize()


def _waits(step: Callable[[Tensor], None], scene: Scene) -> int:
    """How often one step makes the host wait for the card."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            step(scene.views[:1])
        finally:
            torch.cuda.set_sync_debug_mode("default")
    return sum("synchroniz" in str(warning.message) for warning in caught)


def _share_in_kernels(step: Callable[[Tensor], None], scene: Scene) -> float:
    """Time of the kernels of a pass over the time of a pass; they run one after the other."""
    whole = _pass(step, scene) * len(scene.views)
    from torch.profiler import ProfilerActivity, profile

    with profile(activities=[ProfilerActivity.CUDA]) as profiler:
        _pass(step, scene)
    events: Any = profiler.key_averages()
    return float(sum(event.self_device_time_total for event in events)) / 1e3 / whole
