"""Checks the state of a checkpoint before training resumes from it.

A checksum detects damage, but not a file that some other program wrote. The kernels trust the
tensors that they get, so everything about these is checked here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from ..model.gaussians import NAMES
from .config import TrainConfig
from .densification import keeps_statistics

COLUMNS: dict[str, tuple[int, ...]] = {
    "means": (3,),
    "quats": (4,),
    "log_scales": (3,),
    "logit_opacities": (),
}
SH_SHAPES = [(bands, 3) for bands in (1, 4, 9, 16)]
MAX_SECONDS = 1e12
STATISTICS = ("gradient", "views", "weight")


def check_state(state: Mapping[str, Any], config: TrainConfig) -> None:
    """Raise ValueError unless `Trainer.load_state_dict` can continue from the state.

    Args:
        state: as `Trainer.state_dict` returns it; the values may be of any type.
        config: the stage's settings.
    """
    step = _count(state, "step", config.steps)
    for key in ("seconds", "cpu_seconds"):
        if not 0 <= _number(state, key) <= MAX_SECONDS:
            raise ValueError(f"'{key}' is not a time")
    for key in ("loss", "psnr"):  # NaN before the first measurement
        _number(state, key)
    shapes = _check_parameters(_dict(state, "parameters"))
    _check_optimizer(_dict(state, "optimizer"), shapes, config.steps)
    mean = _dict(state, "mean")
    summed = shapes if _count(mean, "count", config.steps) else {}
    for name, tensor in _tensors(_dict(mean, "sums"), summed).items():
        _refuse(name, ~tensor.isfinite())
    rows = shapes["means"][:1]
    outside = state.get("outside")
    _tensors(
        {} if outside is None else {"outside": outside},
        {"outside": rows} if config.tells_outside else {},
        torch.bool,
    )
    density = _dict(state, "density")
    if keeps_statistics(config):
        _count(density, "window", step)
        for name, tensor in _tensors(
            _dict(density, "stats"), dict.fromkeys(STATISTICS, rows)
        ).items():
            _refuse(name, ~(tensor >= 0))


def _check_parameters(parameters: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
    """The shapes of the Gaussians' tensors by name; ValueError if they are not Gaussians."""
    means, sh = parameters.get("means"), parameters.get("sh")
    if not (isinstance(means, Tensor) and means.ndim == 2 and len(means)):
        raise ValueError("it has no Gaussians")
    if not (isinstance(sh, Tensor) and tuple(sh.shape[1:]) in SH_SHAPES):
        raise ValueError("'sh' has a wrong shape")
    columns = {**COLUMNS, "sh": tuple(sh.shape[1:])}
    shapes = {name: (len(means), *columns[name]) for name in NAMES}
    for name, tensor in _tensors(parameters, shapes).items():
        _refuse(name, ~tensor.isfinite())
    return shapes


def _check_optimizer(
    optimizer: Mapping[str, Any], shapes: dict[str, tuple[int, ...]], steps: int
) -> None:
    _count(optimizer, "step_count", steps)
    _count(optimizer, "skipped_rows", 1 << 62)
    for name, tensor in _tensors(_dict(optimizer, "exp_avg"), shapes).items():
        _refuse(f"exp_avg of {name}", tensor.isnan())
    for name, tensor in _tensors(_dict(optimizer, "exp_avg_sq"), shapes).items():
        _refuse(f"exp_avg_sq of {name}", ~(tensor >= 0))
    widths = {name: (math.prod(shape[1:]),) for name, shape in shapes.items()}
    for name, tensor in _tensors(_dict(optimizer, "rates"), widths).items():
        _refuse(f"learning rate of {name}", ~((tensor >= 0) & tensor.isfinite()))


def _dict(state: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = state.get(key)
    if not isinstance(value, dict):
        raise ValueError(f"it has no '{key}'")
    return value


def _count(state: Mapping[str, Any], key: str, most: int) -> int:
    value = state.get(key)
    if type(value) is not int or not 0 <= value <= most:
        raise ValueError(f"'{key}' is not an integer from 0 to {most:,}")
    return value


def _number(state: Mapping[str, Any], key: str) -> float:
    value = state.get(key)
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise ValueError(f"'{key}' is not a number")
    try:
        return float(value)
    except OverflowError as error:
        raise ValueError(f"'{key}' is not a number") from error


def _tensors(
    values: Mapping[str, Any],
    shapes: Mapping[str, tuple[int, ...]],
    dtype: torch.dtype = torch.float32,
) -> dict[str, Tensor]:
    """The tensors; ValueError unless they are exactly those of the shapes, and of the type."""
    for name in values:
        if name not in shapes:
            raise ValueError(f"'{name:.40}' is unknown")
    for name, shape in shapes.items():
        tensor = values.get(name)
        if not isinstance(tensor, Tensor) or tensor.dtype != dtype:
            kind = str(dtype).removeprefix("torch.")
            raise ValueError(f"'{name}' is not a {kind} tensor")
        if tuple(tensor.shape) != shape:
            raise ValueError(f"'{name}' has a wrong shape")
    return dict(values)


def _refuse(name: str, wrong: Tensor) -> None:
    if bool(wrong.any()):
        raise ValueError(f"'{name}' has numbers that training cannot have written")
