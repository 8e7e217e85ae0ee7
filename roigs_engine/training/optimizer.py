"""Adam (Kingma and Ba 2015) that updates the Gaussians the last photo has seen, and no others.

Two rules keep a step's cost in proportion to the view and not to the scene:

* Rows that are not visible keep their value and their moments: no decay.
* There is no dense gradient. Either each parameter's `.grad` is allocated once, as zeros, the
  rasterizer's backward pass adds to the rows of visible Gaussians in place, and `VisibleAdam.step`
  consumes these rows and zeroes them. Or, `fused`, that backward pass is handed the step and takes
  it (`VisibleAdam.backward_step`).

On an NVIDIA GPU a gradient is dense in any case: there the one that the backward pass has made is
used as it is, and dropped after the step.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..cuda.library import has_triton
from ..errors import EngineError
from ..kernels import bindings


class VisibleAdam:
    """Adam on named parameters (N, ...) that all have one row per Gaussian.

    Bias correction counts the optimiser's steps, as in the dense Adam, not a row's own.

    Attributes:
        parameters: the leaf tensors by name.
        exp_avg: first moments by name, shaped as the parameters.
        exp_avg_sq: second moments by name.
        step_count: how many steps were taken.
        skipped_rows: rows so far that were not updated because their gradient was not finite; a
            tensor on devices where reading it would be waiting for them.
    """

    def __init__(
        self,
        parameters: Mapping[str, tuple[Tensor, float | Tensor]],
        *,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-15,
        backend: str = "auto",
        fused: bool = False,
    ) -> None:
        """Begin with zero moments; allocate `.grad` of every parameter, unless fused or "cuda".

        Args:
            parameters: name -> (contiguous leaf tensor, learning rate). The rate is one number, or
                a tensor with one number per element of a row, (48,) for sh (N, 16, 3).
            betas: decay of the two moments.
            eps: added to the root of the second moment.
            backend: "cpu" (compiled kernel: float32 on the CPU), "cuda" (Triton: float32 on an
                NVIDIA GPU), "reference" (plain torch), or "auto", the first that can be used.
            fused: see the class; left out where the backend is not "cpu".

        Raises:
            EngineError: rows, rates or strides that do not fit.
        """
        if backend not in ("auto", "cpu", "cuda", "reference"):
            raise EngineError(f"VisibleAdam: unknown backend {backend!r}.")
        self.betas, self.eps, self.backend, self._may_fuse = betas, eps, backend, fused
        self.parameters: dict[str, Tensor] = {}
        self.exp_avg: dict[str, Tensor] = {}
        self.exp_avg_sq: dict[str, Tensor] = {}
        self.step_count = 0
        self.skipped_rows: int | Tensor = 0
        self._rates: dict[str, Tensor] = {}
        self._adopt({name: tensor for name, (tensor, _) in parameters.items()})
        for name, (tensor, rate) in parameters.items():
            self.exp_avg[name] = torch.zeros_like(tensor, requires_grad=False)
            self.exp_avg_sq[name] = torch.zeros_like(tensor, requires_grad=False)
            self.set_lr(name, rate)

    def set_lr(self, name: str, rate: float | Tensor) -> None:
        """Set a parameter's learning rate: one number, or one per element of a row."""
        if isinstance(rate, float) and name in self._rates:  # every step: spares most of the work
            self._rates[name].fill_(rate)
            return
        parameter = self.parameters[name]
        width = parameter.shape[1:].numel()
        if isinstance(rate, float):  # filled in there: no copy to a device to wait for
            self._rates[name] = torch.full(
                (width,), rate, dtype=torch.float32, device=parameter.device
            )
            return
        given = torch.as_tensor(rate, dtype=torch.float32).flatten()
        if given.numel() not in (1, width):
            raise EngineError(f"{name}: {given.numel()} learning rates for {width} columns.")
        self._rates[name] = given.expand(width).to(parameter.device, copy=True).contiguous()

    @torch.no_grad()
    def step(self, visible: Tensor) -> int | Tensor:
        """Update the visible rows of all parameters by their gradient, and zero that gradient.

        Args:
            visible: (N,) bool. The gradient of all other rows has to be zero and is left alone.

        Returns:
            How many rows were skipped (and their gradient zeroed) because of a NaN or an infinity,
            as `skipped_rows`.

        Raises:
            EngineError: `visible` does not fit the parameters.
        """
        for name, parameter in self.parameters.items():
            if visible.shape != parameter.shape[:1] or visible.dtype != torch.bool:
                raise EngineError(
                    f"visible is {tuple(visible.shape)} {visible.dtype}; "
                    f"{name} has {len(parameter)} rows."
                )
        backend = self._backend()
        if backend == "cpu":
            on, kernels = visible.contiguous(), bindings.kernels()
            return self.step_by(
                lambda adam: kernels.roigs_adam(len(on), adam, bindings.pointer(on))
            )
        self.step_count += 1
        step = self._cuda_step if backend == "cuda" else self._reference_step
        skipped: int | Tensor = sum(step(name, visible) for name in self.parameters)
        self.skipped_rows += skipped
        return skipped

    def step_by(self, kernel: Callable[[Any], int]) -> int:
        """Take a step by a kernel, which gets a pointer to an `Adam` and returns what `step` does.

        The tensors that the structure points to are float32 in main memory.
        """
        self.step_count += 1
        parameters = (bindings.AdamParameter * len(self.parameters))()
        for place, (name, parameter) in zip(parameters, self.parameters.items(), strict=True):
            rates = self._rates[name]
            place.values = parameter.data_ptr()
            place.exp_avg = self.exp_avg[name].data_ptr()
            place.exp_avg_sq = self.exp_avg_sq[name].data_ptr()
            place.gradient = None if parameter.grad is None else parameter.grad.data_ptr()
            place.rates, place.width = rates.data_ptr(), rates.numel()
        adam = bindings.Adam(parameters, len(parameters), self.betas, self.eps, self.step_count)
        skipped = int(kernel(ctypes.byref(adam)))
        self.skipped_rows += skipped
        return skipped

    @property
    def fused(self) -> bool:
        """Whether a backward pass takes the steps; then parameters have no `.grad`."""
        return self._may_fuse and self._backend() == "cpu"

    @property
    def backward_step(self) -> FusedStep | None:
        """What to hand to `rasterize(..., backward_step=...)`; None where `step` is called."""
        return FusedStep(self) if self.fused else None

    def _backend(self) -> str:
        """What is used for the parameters: they are all of one kind."""
        first = next(iter(self.parameters.values()))
        if self.backend != "auto" or first.dtype != torch.float32:
            return "reference" if self.backend == "auto" else self.backend
        if first.device.type == "cuda" and has_triton():
            return "cuda"
        return "cpu" if first.device.type == "cpu" else "reference"

    def _cuda_step(self, name: str, visible: Tensor) -> Tensor | int:
        from . import adam_triton

        parameter = self.parameters[name]
        if parameter.grad is None:
            return 0
        skipped = adam_triton.step(
            parameter,
            (self.exp_avg[name], self.exp_avg_sq[name]),
            visible,
            self._rates[name],
            betas=self.betas,
            eps=self.eps,
            step_count=self.step_count,
        )
        parameter.grad = None
        return skipped

    def _reference_step(self, name: str, visible: Tensor) -> Tensor:
        """The same step in plain torch, on all rows with a mask; the others are tested by it."""
        parameter, gradient = self.parameters[name], self.parameters[name].grad
        mean, square = self.exp_avg[name], self.exp_avg_sq[name]
        assert gradient is not None, "the buffer is allocated here"
        beta1, beta2 = self.betas
        finite = gradient.isfinite().reshape(len(gradient), self._rates[name].numel()).all(dim=1)
        row = (-1,) + (1,) * (gradient.dim() - 1)
        on = (visible & finite).view(row)
        rate = self._rates[name].to(parameter.dtype).view(1, *parameter.shape[1:])

        usable = torch.where(on, gradient, 0)
        mean.copy_(torch.where(on, beta1 * mean + (1 - beta1) * usable, mean))
        square.copy_(torch.where(on, beta2 * square + (1 - beta2) * usable**2, square))
        denominator = (square / (1 - beta2**self.step_count)).sqrt() + self.eps
        change = rate * mean / (1 - beta1**self.step_count) / denominator
        parameter.copy_(torch.where(on, parameter - change, parameter))
        gradient.copy_(torch.where(visible.view(row), 0, gradient))
        return (visible & ~finite).sum()

    @torch.no_grad()
    def replace(self, parameters: Mapping[str, Tensor], rows: Tensor) -> None:
        """Go on with other parameters, after Gaussians were added, removed or reordered.

        Args:
            parameters: a new leaf tensor for every name.
            rows: (N_new,) long, for each new row the old one whose moments it takes over; -1 for
                zero moments. Gradients are zero afterwards.

        Raises:
            EngineError: names or shapes that do not fit.
        """
        if set(parameters) != set(self.parameters):
            raise EngineError(f"Expected {sorted(self.parameters)}, got {sorted(parameters)}.")
        for name, tensor in parameters.items():
            if tensor.shape != (len(rows), *self.parameters[name].shape[1:]):
                raise EngineError(f"{name} is {tuple(tensor.shape)} for {len(rows)} rows.")
        self._adopt(parameters)
        fresh = rows < 0
        source = rows.clamp(min=0)
        for moments in (self.exp_avg, self.exp_avg_sq):
            for name, old in moments.items():
                if len(old) == 0:
                    moments[name] = torch.zeros_like(parameters[name], requires_grad=False)
                else:
                    moments[name] = old.index_select(0, source)
                    moments[name][fresh] = 0

    @torch.no_grad()
    def zero_moments(self, name: str, rows: Tensor | None = None) -> None:
        """Forget the moments of some rows (bool or long index; None: of all) of a parameter."""
        for moments in (self.exp_avg[name], self.exp_avg_sq[name]):
            moments[slice(None) if rows is None else rows] = 0

    def state_dict(self) -> dict[str, Any]:
        """Step count, moments and learning rates; tensors are shared, not copied."""
        return {
            "step_count": self.step_count,
            "skipped_rows": int(self.skipped_rows),
            "exp_avg": dict(self.exp_avg),
            "exp_avg_sq": dict(self.exp_avg_sq),
            "rates": dict(self._rates),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state_dict`; tensors are copied. Raises EngineError if it does not fit."""
        for key in ("exp_avg", "exp_avg_sq"):
            for name, parameter in self.parameters.items():
                saved = state[key].get(name)
                if saved is None or saved.shape != parameter.shape:
                    raise EngineError(f"The optimiser state has no {key} that fits {name}.")
        self.step_count = int(state["step_count"])
        self.skipped_rows = int(state["skipped_rows"])
        for name, parameter in self.parameters.items():
            self.exp_avg[name] = _copy_like(state["exp_avg"][name], parameter)
            self.exp_avg_sq[name] = _copy_like(state["exp_avg_sq"][name], parameter)
            self.set_lr(name, state["rates"][name])

    def _adopt(self, parameters: Mapping[str, Tensor]) -> None:
        counts = {name: len(tensor) for name, tensor in parameters.items()}
        if len(set(counts.values())) > 1:
            raise EngineError(f"Parameters have different numbers of rows: {counts}.")
        for name, tensor in parameters.items():
            if not tensor.is_leaf or not tensor.is_contiguous():
                raise EngineError(f"{name} is not a contiguous leaf tensor.")
            tensor.requires_grad_()
            self.parameters[name] = tensor
        without = self.fused or self._backend() == "cuda"
        for tensor in parameters.values():
            tensor.grad = None if without else torch.zeros_like(tensor)


def _copy_like(saved: Tensor, parameter: Tensor) -> Tensor:
    return saved.detach().to(parameter, copy=True, memory_format=torch.contiguous_format)


@dataclass(frozen=True)
class FusedStep:
    """A step of an optimizer that a backward pass takes (`rasterize.inputs.BackwardStep`)."""

    optimizer: VisibleAdam

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """The tensors it updates."""
        return tuple(self.optimizer.parameters.values())

    def take(self, kernel: Callable[[Any], int]) -> None:
        """Take the step by a kernel, see `VisibleAdam.step_by`."""
        self.optimizer.step_by(kernel)
