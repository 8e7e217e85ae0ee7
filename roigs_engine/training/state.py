"""Checks the state of a checkpoint before training resumes from it.

A checksum detects damage, but not a file that some other program wrote. The kernels trust the
tensors that they get, so everything about these is checked here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import Tensor

from ..model.gaussians import NAMES
from .config import TrainConfig

COLUMNS: dict[str, tuple[int, ...]] = {
    "means": (3,),
    "quats": (4,),
    "log_scales": (3,),
    "logit_opacities": (),
}
SH_SHAPES = [(bands, 3) for bands in (1, 4, 9, 16)]
MAX_SECONDS = 1e12
Shape = tuple[int, ...]


class StateReader:
    """A part of a checkpoint's state, with values of any type; all methods raise ValueError.

    Attributes:
        config: of the stage.
        step: of the checkpoint.
        shapes: of the Gaussians' tensors, by name.
    """

    def __init__(
        self,
        values: Any,
        config: TrainConfig,
        step: int = 0,
        shapes: Mapping[str, Shape] | None = None,
    ) -> None:
        if not isinstance(values, dict):
            raise ValueError("it is not a dict")
        self._values = values
        self.config, self.step, self.shapes = config, step, shapes or {}

    @property
    def rows(self) -> Shape:
        """The shape of one value for each Gaussian."""
        return self.shapes["means"][:1]

    def part(self, key: str) -> StateReader:
        """The part of that name."""
        value = self._values.get(key)
        if not isinstance(value, dict):
            raise ValueError(f"it has no '{key}'")
        return StateReader(value, self.config, self.step, self.shapes)

    def exactly(self, names: Iterable[str]) -> None:
        """Refuse missing and unknown names."""
        expected = set(names)
        for name in self._values:
            if name not in expected:
                raise ValueError(f"'{name!s:.40}' is unknown")
        for name in expected - self._values.keys():
            raise ValueError(f"it has no '{name}'")

    def count(self, key: str, most: int) -> int:
        """An integer from 0 to `most`."""
        value = self._values.get(key)
        if type(value) is not int or not 0 <= value <= most:
            raise ValueError(f"'{key}' is not an integer from 0 to {most:,}")
        return value

    def number(self, key: str) -> float:
        """A number, which may be NaN."""
        value = self._values.get(key)
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            raise ValueError(f"'{key}' is not a number")
        try:
            return float(value)
        except OverflowError as error:
            raise ValueError(f"'{key}' is not a number") from error

    def flag(self, key: str) -> bool:
        """True or False."""
        value = self._values.get(key)
        if not isinstance(value, bool):
            raise ValueError(f"'{key}' is not True or False")
        return value

    def tensors(
        self,
        shapes: Mapping[str, Shape],
        *,
        besides: Iterable[str] = (),
        flags: bool = False,
        least: float = -math.inf,
        finite: bool = False,
    ) -> dict[str, Tensor]:
        """The tensors of these names and shapes, and of no others.

        Args:
            shapes: by name.
            besides: names of other values.
            flags: bool instead of float32.
            least: their smallest number; NaN is none, unless it is minus infinity.
            finite: whether numbers are finite.
        """
        self.exactly((*shapes, *besides))
        dtype = torch.bool if flags else torch.float32
        found = {}
        for name, shape in shapes.items():
            tensor = self._values[name]
            if not isinstance(tensor, Tensor) or tensor.dtype != dtype:
                kind = str(dtype).removeprefix("torch.")
                raise ValueError(f"'{name}' is not a {kind} tensor")
            if tuple(tensor.shape) != shape:
                raise ValueError(f"'{name}' has a wrong shape")
            wrong = ~tensor.isfinite() if finite else tensor.isnan()
            if not flags and bool((wrong | ~(tensor >= least)).any()):
                raise ValueError(f"'{name}' has numbers that training cannot have written")
            found[name] = tensor
        return found


def check_state(state: Mapping[str, Any], config: TrainConfig) -> None:
    """Raise ValueError unless `Trainer.load_state_dict` can continue from the state.

    Args:
        state: as `Trainer.state_dict` returns it; the values may be of any type.
        config: the stage's settings.
    """
    whole = StateReader(state, config)
    step = whole.count("step", config.steps)
    for key in ("seconds", "cpu_seconds"):
        if not 0 <= whole.number(key) <= MAX_SECONDS:
            raise ValueError(f"'{key}' is not a time")
    for key in ("loss", "psnr"):  # NaN before the first measurement
        whole.number(key)
    shapes = _shapes(state.get("parameters"))
    whole = StateReader(state, config, step, shapes)
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
    optimizer.count("step_count", optimizer.config.steps)
    optimizer.count("skipped_rows", 1 << 62)
    optimizer.part("exp_avg").tensors(optimizer.shapes)
    optimizer.part("exp_avg_sq").tensors(optimizer.shapes, least=0.0)
    widths = {name: (math.prod(shape[1:]),) for name, shape in optimizer.shapes.items()}
    optimizer.part("rates").tensors(widths, least=0.0, finite=True)
