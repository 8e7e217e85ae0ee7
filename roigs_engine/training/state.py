"""Checks the state of a checkpoint before training resumes from it.

A checksum detects damage, but not a file that some other program wrote. The kernels trust the
tensors that they get, so everything about these is checked here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from torch import Tensor

from ..model.gaussians import NAMES
from .config import TrainConfig
from .state_reader import Shape, StateReader

COLUMNS: dict[str, tuple[int, ...]] = {
    "means": (3,),
    "quats": (4,),
    "log_scales": (3,),
    "logit_opacities": (),
}
SH_SHAPES = [(bands, 3) for bands in (1, 4, 9, 16)]
MAX_SECONDS = 1e12


def check_state(state: Mapping[str, Any], config: TrainConfig) -> None:
    """Raise ValueError unless `Trainer.load_state_dict` can continue from the state.

    Args:
        state: as `Trainer.state_dict` returns it; the values may be of any type.
        config: the stage's settings.
    """
    whole = StateReader(state, config.steps)
    step = whole.count("step", config.steps)
    for key in ("seconds", "cpu_seconds"):
        if not 0 <= whole.number(key) <= MAX_SECONDS:
            raise ValueError(f"'{key}' is not a time")
    for key in ("loss", "psnr"):  # NaN before the first measurement
        whole.number(key)
    shapes = _shapes(state.get("parameters"))
    whole = StateReader(state, config.steps, step, shapes)
    whole.part("parameters").tensors(shapes, finite=True)
    _check_optimizer(whole.part("optimizer"))
    acting = [each for each in config.mechanisms if each.acts(config)]
    mechanisms = whole.part("mechanisms")
    mechanisms.exactly(each.name for each in acting)
    for each in acting:
        each.check_state(mechanisms.part(each.name))


def _shapes(parameters: Any) -> dict[str, Shape]:
    """The shapes of the Gaussians' tensors by name; ValueError if they are not Gaussians."""
    values = parameters if isinstance(parameters, dict) else {}
    means, sh = values.get("means"), values.get("sh")
    if not (isinstance(means, Tensor) and means.ndim == 2 and len(means)):
        raise ValueError("it has no Gaussians")
    if not (isinstance(sh, Tensor) and tuple(sh.shape[1:]) in SH_SHAPES):
        raise ValueError("'sh' has a wrong shape")
    columns = {**COLUMNS, "sh": tuple(sh.shape[1:])}
    return {name: (len(means), *columns[name]) for name in NAMES}


def _check_optimizer(optimizer: StateReader) -> None:
    optimizer.count("step_count", optimizer.steps)
    optimizer.count("skipped_rows", 1 << 62)
    optimizer.part("exp_avg").tensors(optimizer.shapes)
    optimizer.part("exp_avg_sq").tensors(optimizer.shapes, least=0.0)
    widths = {name: (math.prod(shape[1:]),) for name, shape in optimizer.shapes.items()}
    optimizer.part("rates").tensors(widths, least=0.0, finite=True)
