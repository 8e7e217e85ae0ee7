"""Checked access to the values of a checkpoint's state."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

import torch
from torch import Tensor

Shape = tuple[int, ...]


class StateReader:
    """A part of a checkpoint's state with unchecked values; all methods raise ValueError.

    Attributes:
        steps: of the stage.
        step: of the checkpoint.
        shapes: of the Gaussians' tensors, by name.
    """

    def __init__(
        self, values: Any, steps: int, step: int = 0, shapes: Mapping[str, Shape] | None = None
    ) -> None:
        if not isinstance(values, dict):
            raise ValueError("it is not a dict")
        self._values = values
        self.steps, self.step, self.shapes = steps, step, shapes or {}

    @property
    def rows(self) -> Shape:
        """Return the shape of one value per Gaussian."""
        return self.shapes["means"][:1]

    def part(self, key: str) -> StateReader:
        if not isinstance(self._values.get(key), dict):
            raise ValueError(f"it has no '{key}'")
        return StateReader(self._values[key], self.steps, self.step, self.shapes)

    def exactly(self, names: Iterable[str]) -> None:
        """Refuse missing or unknown names."""
        expected = set(names)
        for name in self._values:
            if name not in expected:
                raise ValueError(f"'{name!s:.40}' is unknown")
        for name in expected - self._values.keys():
            raise ValueError(f"it has no '{name}'")

    def count(self, key: str, most: int) -> int:
        """Return an integer from 0 to `most`."""
        value = self._values.get(key)
        if type(value) is not int or not 0 <= value <= most:
            raise ValueError(f"'{key}' is not an integer from 0 to {most:,}")
        return value

    def number(self, key: str) -> float:
        """Return a number, which may be NaN."""
        value = self._values.get(key)
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            with suppress(OverflowError):
                return float(value)
        raise ValueError(f"'{key}' is not a number")

    def flag(self, key: str) -> bool:
        """Return True or False."""
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
        """Return the tensors with these names and shapes; there must be no others.

        Args:
            shapes: by name.
            besides: names of further values.
            flags: the tensors are bool instead of float32.
            least: smallest allowed number. NaN is never allowed.
            finite: refuse infinite numbers.
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
