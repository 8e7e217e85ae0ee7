"""How long a training step takes on a device."""

from __future__ import annotations

import time

import torch

from .gpu_check import NAMES, Scene, draw, scene
from .losses import photo_loss
from .optimizer import VisibleAdam

COUNT, SIZE = 100_000, (960, 640)
WARM_UP = 2  # steps: memory is new, caches are cold


def step_milliseconds(device: torch.device, backend: str, *, steps: int) -> float:
    """The mean of some steps on a made-up scene of `COUNT` Gaussians and `SIZE` pixels."""
    made = scene(device, COUNT, SIZE)
    optimizer = VisibleAdam({name: (made.model[name], 1e-3) for name in NAMES}, fused=True)
    for _ in range(WARM_UP):
        _step(made, optimizer, backend)
    _wait(device)
    started = time.perf_counter()
    for _ in range(steps):
        _step(made, optimizer, backend)
    _wait(device)
    return 1000 * (time.perf_counter() - started) / steps


def _step(made: Scene, optimizer: VisibleAdam, backend: str) -> None:
    output = draw(made, backend, backward_step=optimizer.backward_step)
    photo_loss(output.image, made.photo, backend=backend).loss.backward()  # type: ignore[no-untyped-call]


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
