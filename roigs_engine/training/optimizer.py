"""Adam (Kingma and Ba 2015) for only those Gaussians that get a gradient from the last photo.

Two rules make a step's cost depend on the photo's content and not on the scene:

* Rows that are not visible, or whose gradient is zero because others hide them, keep their values
  and moments, without decay.
* There is no gradient in memory: the rasterizer's backward pass takes the step itself
  (`VisibleAdam.backward_step`), on all rows that get a gradient from a pixel, even if that of a
  parameter is zero. SH of higher degrees than are drawn stay unchanged.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from ..cuda.bindings import address
from ..errors import EngineError
from ..gpu.resident import Resident
from ..kernels import bindings
from ..model.gaussians import Gaussians
from ..rasterize.inputs import BackwardStep
from .edits import chosen_rows

BETAS, EPS = (0.9, 0.999), 1e-15  # decay of the two moments; added to the second one's root


class VisibleAdam:
    """Adam on named parameters (N, ...) that all have one row per Gaussian.

    Bias correction counts the optimizer's steps, as in dense Adam, not the steps of each row.

    Attributes:
        row_rates: (N,) float32, a factor on the learning rates of each Gaussian in the next steps;
            None for 1. It does not follow the rows in `replace`, and does not belong to the state
            or to a `part`.
        skipped_rows: number of rows skipped so far because of NaN or Inf gradients; a tensor on a
            GPU, since reading it would wait for the GPU.
    """

    def __init__(self, parameters: Mapping[str, tuple[Tensor, float | Tensor]]) -> None:
        """Start with zero moments.

        Args:
            parameters: name -> (contiguous leaf tensor, learning rate). The learning rate is one
                number, or a tensor with one number per element of a row: (48,) for sh (N, 16, 3).

        Raises:
            EngineError: wrong numbers of rows or learning rates, or wrong strides.
        """
        self._parameters: dict[str, Tensor] = {}
        self._exp_avg: dict[str, Tensor] = {}
        self._exp_avg_sq: dict[str, Tensor] = {}
        self._resident = Resident(self._tensors, stays=True)
        self.row_rates: Tensor | None = None
        self.step_count = 0
        self.skipped_rows: int | Tensor = 0
        self._learning_rates: dict[str, Tensor] = {}
        self._adopt({name: tensor for name, (tensor, _) in parameters.items()})
        for name, (tensor, lr) in parameters.items():
            self._exp_avg[name] = torch.zeros_like(tensor, requires_grad=False)
            self._exp_avg_sq[name] = torch.zeros_like(tensor, requires_grad=False)
            self.set_lr(name, lr)

    @property
    def parameters(self) -> dict[str, Tensor]:
        """Return the leaf tensors by name, copied back from a GPU that torch does not know."""
        self._resident.settle()
        return self._parameters

    @property
    def exp_avg(self) -> dict[str, Tensor]:
        """Return the parameters' first moments."""
        self._resident.settle()
        return self._exp_avg

    @property
    def exp_avg_sq(self) -> dict[str, Tensor]:
        """Return the parameters' second moments."""
        self._resident.settle()
        return self._exp_avg_sq

    def _tensors(self) -> list[list[Tensor]]:
        """Return the tensors for `Resident`."""
        return [list(own.values()) for own in (self._parameters, self._exp_avg, self._exp_avg_sq)]

    def __len__(self) -> int:
        return len(next(iter(self._parameters.values())))

    def set_lr(self, name: str, lr: float | Tensor) -> None:
        """Set a parameter's learning rate: one number, or one per element of a row."""
        parameter = self._parameters[name]
        width = parameter.shape[1:].numel()
        if isinstance(lr, float):  # every step: filled on the device, no copy to wait for
            if name not in self._learning_rates:
                empty = torch.empty(width, dtype=torch.float32, device=parameter.device)
                self._learning_rates[name] = empty
            self._learning_rates[name].fill_(lr)
            return
        values = torch.as_tensor(lr, dtype=torch.float32).flatten()
        if values.numel() not in (1, width):
            raise EngineError(f"{name}: {values.numel()} learning rates for {width} columns.")
        values = values.expand(width).to(parameter.device, copy=True)
        self._learning_rates[name] = values.contiguous()

    def step_by(self, kernel: Callable[[Any], int | Tensor]) -> int | Tensor:
        """Take a step with a kernel, which gets a `bindings.Adam*` and returns the skipped rows."""
        self._check_row_rates()
        self.step_count += 1
        parameters = (bindings.AdamParameter * len(self._parameters))()
        for entry, (name, parameter) in zip(parameters, self._parameters.items(), strict=True):
            learning_rates = self._learning_rates[name]
            entry.values = parameter.data_ptr()
            entry.exp_avg = self._exp_avg[name].data_ptr()
            entry.exp_avg_sq = self._exp_avg_sq[name].data_ptr()
            entry.gradient = address(parameter.grad)
            entry.rates, entry.width = learning_rates.data_ptr(), learning_rates.numel()
        rates, count = address(self.row_rates), len(parameters)
        adam = bindings.Adam(parameters, count, BETAS, EPS, self.step_count, rates)
        skipped = kernel(ctypes.byref(adam))
        self.skipped_rows += skipped
        return skipped

    def _check_row_rates(self) -> None:
        """Check `row_rates`, because the kernels do not."""
        rates, first = self.row_rates, next(iter(self._parameters.values()))
        if rates is None:
            return
        fits = rates.shape == first.shape[:1] and rates.device == first.device
        if not (fits and rates.dtype == torch.float32 and rates.is_contiguous()):
            raise EngineError(
                f"row_rates is {tuple(rates.shape)} {rates.dtype} on {rates.device} "
                f"for {len(first)} Gaussians on {first.device}."
            )

    @property
    def backward_step(self) -> BackwardStep:
        """Return the argument of `rasterize(..., backward_step=...)`."""
        tensors = tuple(self._parameters.values())
        return BackwardStep(tensors, self.step_by, resident=self._resident)

    @torch.no_grad()
    def replace(self, parameters: Mapping[str, Tensor], rows: Tensor) -> None:
        """Replace the parameters after Gaussians were added, removed or reordered.

        Args:
            parameters: a new leaf tensor for every name; EngineError if they do not fit.
            rows: (N_new,) long: for each new row, the old row whose moments it gets; -1 for zero
                moments. Gradients are None afterwards.
        """
        if set(parameters) != set(self.parameters):
            raise EngineError(f"Expected {sorted(self.parameters)}, got {sorted(parameters)}.")
        for name, tensor in parameters.items():
            if tensor.shape != (len(rows), *self.parameters[name].shape[1:]):
                raise EngineError(f"{name} is {tuple(tensor.shape)} for {len(rows)} rows.")
        self._adopt(parameters)
        for moments in (self.exp_avg, self.exp_avg_sq):
            for name, old in moments.items():
                moments[name] = chosen_rows(old, rows)

    @torch.no_grad()
    def part(self, rows: Tensor) -> VisibleAdam:
        """Return an optimizer of copies of these rows and their moments; `put` writes them back."""
        copies = {name: p.detach()[rows].contiguous() for name, p in self.parameters.items()}
        rates = {name: (copy, self._learning_rates[name]) for name, copy in copies.items()}
        part = type(self)(rates)
        part._resident = Resident(part._tensors, stays=False)
        part.step_count = self.step_count
        for name in copies:
            part.exp_avg[name] = self.exp_avg[name][rows].contiguous()
            part.exp_avg_sq[name] = self.exp_avg_sq[name][rows].contiguous()
        return part

    @torch.no_grad()
    def put(self, part: VisibleAdam, rows: Tensor) -> None:
        """Write back the rows of a `part` that has taken steps."""
        for name, parameter in self.parameters.items():
            parameter[rows] = part.parameters[name].detach()
            self.exp_avg[name][rows] = part.exp_avg[name]
            self.exp_avg_sq[name][rows] = part.exp_avg_sq[name]
        self.step_count = part.step_count
        self.skipped_rows += part.skipped_rows

    @torch.no_grad()
    def zero_moments(self, *names: str) -> None:
        """Zero the moments of parameters.

        The second moment grows more slowly than the first, and bias correction counts all steps of
        the optimizer. So late in a stage, the following steps grow to six times their size, and
        shrink within some hundred steps.
        """
        for name in names:
            self.exp_avg[name].zero_()
            self.exp_avg_sq[name].zero_()

    def state_dict(self) -> dict[str, Any]:
        """Return the state; tensors are shared, not copied."""
        return {
            "step_count": self.step_count,
            "skipped_rows": int(self.skipped_rows),
            "exp_avg": dict(self.exp_avg),
            "exp_avg_sq": dict(self.exp_avg_sq),
            "rates": dict(self._learning_rates),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a `state_dict` that fits (`checkpoint.check_state`); copies tensors."""
        self.step_count, self.skipped_rows = int(state["step_count"]), int(state["skipped_rows"])
        for name, parameter in self.parameters.items():
            for key, moments in (("exp_avg", self.exp_avg), ("exp_avg_sq", self.exp_avg_sq)):
                saved = state[key][name].detach().to(parameter, copy=True)
                moments[name] = saved.contiguous()
            self.set_lr(name, state["rates"][name])

    def _adopt(self, parameters: Mapping[str, Tensor]) -> None:
        counts = {name: len(tensor) for name, tensor in parameters.items()}
        if len(set(counts.values())) > 1:
            raise EngineError(f"Parameters have different numbers of rows: {counts}.")
        for name, tensor in parameters.items():
            if not tensor.is_leaf or not tensor.is_contiguous():
                raise EngineError(f"{name} is not a contiguous leaf tensor.")
            tensor.requires_grad_()
            self._parameters[name], tensor.grad = tensor, None


def leaves(gaussians: Gaussians) -> Gaussians:
    """Return the same values as contiguous leaf tensors that require gradients."""
    return gaussians.with_tensors(
        {n: t.detach().contiguous().requires_grad_() for n, t in gaussians.tensors().items()}
    )
