"""Whether a GPU computes what the CPU does: a small scene, drawn and differentiated on both.

It is done once for each combination of card, driver, torch and kernels; a record on disk says that
it has passed.
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

import torch
from torch import Tensor

from ..context import QUIET, Context
from ..cuda import driver, sources
from ..errors import EngineError, KernelError
from ..formats.files import read_json, write_json
from ..kernels.library import user_cache
from ..rasterize import RenderOutput, rasterize
from .losses import photo_loss
from .optimizer import VisibleAdam

LIMIT = 2e-3
"""The largest relative error (Euclidean norm) of any result. Rounding alone gives about 1e-4: it
decides whether an alpha next to 1/255 is drawn."""

SIZE = (160, 120)
COUNT = 2000
NAMES = ("means", "quats", "log_scales", "logit_opacities", "sh")
USE_CPU = "Run `python -m roigs_engine check-gpu` and report what it prints; --device cpu trains."


def check_once(device: torch.device, context: Context = QUIET) -> None:
    """Check a GPU unless a record says that it has passed.

    Raises:
        KernelError: it has not; the line has the numbers.
    """
    path, key = user_cache() / "cuda" / "checked.json", machine_key(device)
    try:
        passed = read_json(path)
    except EngineError:
        passed = {}
    if isinstance(passed, dict) and key in passed:
        return
    context.info("Checking the GPU against the CPU, once.")
    errors = check(device)
    record = {**(passed if isinstance(passed, dict) else {}), key: errors}
    try:
        write_json(path, record, durable=False)
    except EngineError:
        context.info("The check cannot be recorded; it is repeated next time.")


def machine_key(device: torch.device) -> str:
    """A hash of all that a new check is needed for."""
    name = str(device)
    if device.type == "cuda":
        name = f"{torch.cuda.get_device_name(device)} {torch.cuda.get_device_capability(device)}"
    parts = (name, driver.build(), torch.__version__, sources.source_key())
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def check(device: torch.device) -> dict[str, float]:
    """The relative error of each result on the GPU.

    Raises:
        KernelError: one is above `LIMIT`, or the GPU failed; one line.
    """
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
    """The relative error of each result on the GPU, without a limit."""
    ours, truth = (results(torch.device(d), b) for d, b in ((device, "cuda"), ("cpu", "cpu")))
    return {name: _relative_error(ours[name], truth[name]) for name in truth}


def results(device: torch.device, backend: str) -> dict[str, Tensor]:
    """All that a training step computes of the check's scene, by name."""
    model, view, photo = scene(device)
    optimizer = VisibleAdam({name: (model[name], 1e-3) for name in NAMES}, fused=True)
    before = {name: tensor.detach().clone() for name, tensor in model.items()}
    output = draw(model, view, backend, backward_step=optimizer.backward_step)
    weights = torch.linspace(0, 2, photo.shape[1], device=device).expand(photo.shape[:2])
    loss = photo_loss(output.image, photo, weights=weights, backend=backend)
    loss.loss.backward()  # type: ignore[no-untyped-call]
    with torch.no_grad():
        region = (20, 20, 140, 90)
        options = {"with_max_weight": True, "with_weight_sum": True, "with_depth": True}
        part = draw(before, view, backend, mask=region, **options)
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
    """1 plus how far the first step is from what Adam's moments say, in learning rates.

    The steps themselves cannot be compared: where a gradient is about 0, its sign decides.
    """
    mean, square = optimizer.exp_avg[name] / 0.1, optimizer.exp_avg_sq[name] / 0.001
    step = 1e-3 * mean / (square.sqrt() + optimizer.eps)
    now = optimizer.parameters[name].detach()
    return 1 + ((now - (before - step)).abs() / 1e-3).clamp(min=1e-3)


def draw(
    model: dict[str, Tensor], view: tuple[Tensor, Tensor], backend: str, **options: Any
) -> RenderOutput:
    """The check's scene as training draws it."""
    means, quats, scales, opacities, sh = (model[name] for name in NAMES)
    gaussians = means, quats, scales, opacities, sh
    return rasterize(*gaussians, *view, *SIZE, raw=True, backend=backend, **options)


def scene(device: torch.device) -> tuple[dict[str, Tensor], tuple[Tensor, Tensor], Tensor]:
    """Gaussians by name, a camera, a photo: the same on every device."""
    generator = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    model = {
        "means": normal(COUNT, 3) + torch.tensor([0.0, 0.0, 4.0]),
        "quats": normal(COUNT, 4),
        "log_scales": 0.5 * normal(COUNT, 3) + math.log(0.05),
        "logit_opacities": normal(COUNT),
        "sh": 0.3 * normal(COUNT, 16, 3),
    }
    width, height = SIZE
    K = torch.tensor([[width, 0.0, 0.5 * width], [0.0, width, 0.5 * height], [0.0, 0.0, 1.0]])  # noqa: N806
    photo = torch.randint(0, 256, (height, width, 3), dtype=torch.uint8, generator=generator)
    view = (torch.eye(4)[None].to(device), K[None].to(device))
    return {name: tensor.to(device) for name, tensor in model.items()}, view, photo.to(device)


def _relative_error(value: Tensor, truth: Tensor) -> float:
    return float((value - truth).norm()) / max(float(truth.norm()), 1e-30)
