"""Checks a GPU against the CPU with a small scene, drawn and differentiated on both.

This is done once for each combination of card, driver, torch and kernels. A record on disk stores
that it has passed.
"""

from __future__ import annotations

import hashlib
import math
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ..context import QUIET, Context
from ..cuda import compiler, driver
from ..cuda.device import CPU, GPU
from ..errors import EngineError, KernelError
from ..formats.files import read_json, write_json
from ..gpu import program
from ..kernels.library import user_cache
from ..model.gaussians import NAMES
from ..rasterize import RenderOutput, rasterize
from .losses import photo_loss
from .optimizer import EPS, VisibleAdam

LIMIT = 2e-3
"""The largest relative error (Euclidean norm) of any result. Rounding alone gives about 1e-4: it
decides whether an alpha next to 1/255 is drawn."""

LONGEST = 120.0
"""Seconds that a check may take."""

SIZE = (160, 120)
COUNT = 2000
COUNT_TIMED, SIZE_TIMED = 100_000, (960, 640)
STEPS_TIMED = 5
WARM_UP = 2  # steps that are not timed: memory is new, caches are cold
USE_CPU = "Run `python -m roigs_engine check-gpu` and report what it prints; --device cpu trains."


def check_once(device: torch.device, context: Context = QUIET, must_gain: bool = False) -> None:
    """Check a GPU unless a record says that it has passed.

    Args:
        device: of the tensors; the CPU for a GPU that `gpu.program` has opened.
        context: receives messages.
        must_gain: also measure whether a step takes less time than on the CPU.

    Raises:
        KernelError: the check failed; the message has the numbers. Or an earlier check never ended.
    """
    _check_once(device, context)
    if must_gain and backend_of(device) == GPU:
        _check_gain(device, context)


def backend_of(device: torch.device) -> str:
    """Return the backend to check."""
    return "cuda" if program.drawing(device.type) != GPU else GPU


def _check_gain(device: torch.device, context: Context) -> None:
    """Raise KernelError unless steps on the open GPU are faster than the CPU's; measured once."""
    key = f"{machine_key(device)} ms"
    found = _records().get(key)
    if not isinstance(found, dict):
        context.info("Measuring whether the GPU is faster than the CPU, once.")
        found = {name: step_milliseconds(CPU, name, steps=STEPS_TIMED) for name in (GPU, "cpu")}
        _record(key, found)
    gpu, cpu = float(found.get(GPU, 1)), float(found.get("cpu", 0))
    if gpu >= cpu:
        opened = program.opened()
        title = "" if opened is None else opened.adapter.title
        raise KernelError(f"{title}, takes {gpu:.0f} ms for a step, the CPU {cpu:.0f}")


def _check_once(device: torch.device, context: Context) -> None:
    key = machine_key(device)
    before = _records().get(key)
    if isinstance(before, dict):
        return
    if isinstance(before, float) and time.time() - before > LONGEST:
        raise KernelError("GPU check: the last check did not finish.", USE_CPU)
    context.info("Checking the GPU against the CPU, once.")
    errors = None
    _record(key, time.time())  # stays if the driver hangs or crashes the process
    try:
        errors = check(device)
    finally:
        _record(key, errors)


def check_again(device: torch.device) -> None:
    """Check a GPU without regard to the record, and record it if it passes. Raises KernelError."""
    errors = check(device)
    _record(machine_key(device), errors)


def _records() -> dict[str, Any]:
    """Return `machine_key` -> errors of a passed check, or the start time of an unfinished one."""
    try:
        found = read_json(user_cache() / "cuda" / "checked.json")
    except EngineError:
        return {}
    return found if isinstance(found, dict) else {}


def _record(key: str, value: dict[str, float] | float | None) -> None:
    """Record a value, or remove it for None; if this cannot be written, the check is repeated."""
    records = {name: found for name, found in _records().items() if name != key}
    if value is not None:
        records[key] = value
    with suppress(EngineError):
        write_json(user_cache() / "cuda" / "checked.json", records, durable=False)


def machine_key(device: torch.device) -> str:
    """Return a hash of everything whose change needs a new check."""
    name, gpu = str(device), program.opened()
    if gpu is not None:
        parts = gpu.adapter.title, gpu.adapter.driver, str(torch.__version__), program.source_key()
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]
    if device.type == "cuda":
        name = f"{torch.cuda.get_device_name(device)} {torch.cuda.get_device_capability(device)}"
    parts = (name, driver.build(), torch.__version__, compiler.source_key())
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def check(device: torch.device) -> dict[str, float]:
    """Return each result's relative error; KernelError if one is above `LIMIT` or the GPU fails."""
    try:
        errors = compare(device)
    except torch.OutOfMemoryError as error:
        raise KernelError(
            "GPU check: the GPU memory is full.", "Close other programs that use the GPU."
        ) from error
    except KernelError as error:
        raise KernelError(f"GPU check: {error.message}", error.hint) from error
    except RuntimeError as error:  # torch: CUDA error: ..
        first = (str(error).splitlines() or ["unknown error"])[0]
        raise KernelError(f"GPU check: {first}.", USE_CPU) from error
    wrong = {name: error for name, error in errors.items() if not error <= LIMIT}
    if wrong:
        worst = ", ".join(f"{name} by {error:.1e}" for name, error in wrong.items())
        raise KernelError(f"GPU check: differs from the CPU (limit {LIMIT:.0e}): {worst}.", USE_CPU)
    return errors


def compare(device: torch.device) -> dict[str, float]:
    """Return the relative error of each result on the GPU, without a limit."""
    ours, truth = results(device, backend_of(device)), results(CPU, "cpu")
    return {
        name: float((ours[name] - each).norm()) / max(float(each.norm()), 1e-30)
        for name, each in truth.items()
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """The test scene on one device."""

    model: dict[str, Tensor]  # by name, in the trained form (logs, logits)
    view: tuple[Tensor, Tensor]  # a camera's pose (1, 4, 4) and intrinsics (1, 3, 3)
    photo: Tensor  # (H, W, 3) uint8


def results(device: torch.device, backend: str) -> dict[str, Tensor]:
    """Compute all results of a training step on the check's scene, by name."""
    made = scene(device, COUNT, SIZE)
    before = {name: tensor.clone() for name, tensor in made.model.items()}
    optimizer = VisibleAdam({name: (made.model[name], 1e-3) for name in NAMES})
    output = draw(made, backend, backward_step=optimizer.backward_step)
    width, height = SIZE
    weights = torch.linspace(0, 2, width, device=device).expand(height, width)
    loss = photo_loss(output.image, made.photo, weights=weights, backend=loss_backend(backend))
    loss.loss.backward()  # type: ignore[no-untyped-call]
    options: dict[str, Any] = {"with_max_weight": True, "with_weight_sum": True}
    region = (width // 8, height // 6, width * 7 // 8, height * 3 // 4)
    part = draw(replace(made, model=before), backend, mask=region, with_depth=True, **options)
    found = {
        "image": output.image,
        "loss": loss.loss,
        "visible": output.visible,
        "grad2d": output.grad2d,
        "part": part.image,
        "depth": part.depth,
        "largest weights": part.max_weight,
        "weights": part.weight_sum,
    }
    for name in NAMES:
        found[f"gradient of {name}"] = optimizer.exp_avg[name]
        found[f"step of {name}"] = _misstep(optimizer, name, before[name])
    return {name: t.detach().double().cpu() for name, t in found.items() if t is not None}


def _misstep(optimizer: VisibleAdam, name: str, before: Tensor) -> Tensor:
    """Return 1 plus the first step's distance from that of Adam's moments, in learning rates.

    The steps themselves cannot be compared: where a gradient is about 0, its sign decides the step.
    """
    mean, square = optimizer.exp_avg[name] / 0.1, optimizer.exp_avg_sq[name] / 0.001
    step = 1e-3 * mean / (square.sqrt() + EPS)
    now = optimizer.parameters[name].detach()
    return 1 + ((now - (before - step)).abs() / 1e-3).clamp(min=1e-3)


def loss_backend(backend: str) -> str:
    """Return the loss backend for a backend of `rasterize`: that of its tensors' device."""
    return "cpu" if backend == GPU else backend


def draw(made: Scene, backend: str, **options: Any) -> RenderOutput:
    """Draw the scene as training does."""
    means, quats, scales, opacities, sh = (made.model[name] for name in NAMES)
    height, width, _ = made.photo.shape
    view = *made.view, width, height
    options |= {"raw": True, "backend": backend}
    return rasterize(means, quats, scales, opacities, sh, *view, **options)


def scene(device: torch.device, count: int, size: tuple[int, int]) -> Scene:
    """Create random Gaussians in front of a camera, and a photo of noise; equal on every device."""
    generator = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    model = {
        "means": normal(count, 3) + torch.tensor([0.0, 0.0, 4.0]),
        "quats": normal(count, 4),
        "log_scales": 0.5 * normal(count, 3) + math.log(0.6 / count**0.33),
        "logit_opacities": normal(count),
        "sh": 0.3 * normal(count, 16, 3),
    }
    width, height = size
    intrinsics = torch.tensor(
        [[width, 0.0, 0.5 * width], [0.0, width, 0.5 * height], [0.0, 0.0, 1.0]]
    )
    photo = torch.randint(0, 256, (height, width, 3), dtype=torch.uint8, generator=generator)
    return Scene(
        model={name: tensor.to(device) for name, tensor in model.items()},
        view=(torch.eye(4)[None].to(device), intrinsics[None].to(device)),
        photo=photo.to(device),
    )


def step_milliseconds(device: torch.device, backend: str, *, steps: int) -> float:
    """Return the mean time of steps with `COUNT_TIMED` random Gaussians on `SIZE_TIMED` pixels."""
    made = scene(device, COUNT_TIMED, SIZE_TIMED)
    optimizer = VisibleAdam({name: (made.model[name], 1e-3) for name in NAMES})
    started = 0.0
    for step in range(WARM_UP + steps):
        if step == WARM_UP:
            _wait(device)
            started = time.perf_counter()
        output = draw(made, backend, backward_step=optimizer.backward_step)
        loss = photo_loss(output.image, made.photo, backend=loss_backend(backend))
        loss.loss.backward()  # type: ignore[no-untyped-call]
    _wait(device)
    return 1000 * (time.perf_counter() - started) / steps


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
