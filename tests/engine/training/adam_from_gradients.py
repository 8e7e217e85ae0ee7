"""Adam that takes its steps from gradients in memory, as steps in the backward pass must."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.kernels import bindings
from roigs_engine.training.optimizer import BETAS, EPS, VisibleAdam


class AdamFromGradients(VisibleAdam):
    """Its parameters have a `.grad`, to which backward passes add; `step` applies and zeroes it.

    The kernel `roigs_adam` takes the steps, or with `reference` plain torch, in any dtype.
    """

    def __init__(
        self, parameters: Mapping[str, tuple[Tensor, float | Tensor]], *, reference: bool = False
    ) -> None:
        self.reference = reference
        super().__init__(parameters)

    def _adopt(self, parameters: Mapping[str, Tensor]) -> None:
        super()._adopt(parameters)
        for tensor in parameters.values():
            tensor.grad = torch.zeros_like(tensor)

    @torch.no_grad()
    def step(self, visible: Tensor) -> int | Tensor:
        """Update the rows of (N,) bool that have a gradient; the number of rows skipped for NaN."""
        for name, parameter in self.parameters.items():
            if visible.shape != parameter.shape[:1] or visible.dtype != torch.bool:
                raise EngineError(f"visible is {visible.shape} {visible.dtype}; {name} differs.")
        on = torch.zeros_like(visible)  # where a gradient is not zero; NaN is not
        for parameter in self.parameters.values():
            assert parameter.grad is not None
            on |= parameter.grad.reshape(len(on), parameter.shape[1:].numel()).ne(0).any(dim=1)
        on &= visible
        if not self.reference:
            kernels = bindings.kernels()
            return self.step_by(lambda adam: kernels.roigs_adam(len(on), adam, on.data_ptr()))
        self._check_row_rates()
        self.step_count += 1
        skipped: int | Tensor = sum(self._reference_step(name, on) for name in self.parameters)
        self.skipped_rows += skipped
        return skipped

    def _reference_step(self, name: str, visible: Tensor) -> Tensor:
        parameter, gradient = self.parameters[name], self.parameters[name].grad
        mean, square = self.exp_avg[name], self.exp_avg_sq[name]
        assert gradient is not None
        beta1, beta2 = BETAS
        learning_rates = self._learning_rates[name]
        finite = gradient.isfinite().reshape(len(gradient), learning_rates.numel()).all(dim=1)
        row = (-1,) + (1,) * (gradient.dim() - 1)
        on = (visible & finite).view(row)
        lr = learning_rates.to(parameter.dtype).view(1, *parameter.shape[1:])

        usable = torch.where(on, gradient, 0)
        mean.copy_(torch.where(on, beta1 * mean + (1 - beta1) * usable, mean))
        square.copy_(torch.where(on, beta2 * square + (1 - beta2) * usable**2, square))
        denominator = (square / (1 - beta2**self.step_count)).sqrt() + EPS
        if self.row_rates is not None:
            lr = lr * self.row_rates.to(lr.dtype).view(row)
        change = lr * mean / (1 - beta1**self.step_count) / denominator
        parameter.copy_(torch.where(on, parameter - change, parameter))
        gradient.copy_(torch.where(visible.view(row), 0, gradient))
        return (visible & ~finite).sum()
