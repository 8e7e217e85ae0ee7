"""Adam's step inside the backward pass: what it refuses, what it leaves alone.

That it has the bits of a step from gradients, at any number of threads, is in
test_kernels_property.
"""

from __future__ import annotations

from typing import TypeVar

import pytest
import torch
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.rasterize import RenderOutput
from roigs_engine.training.optimizer import VisibleAdam
from tests.engine.rasterize_cases import NAMES, gaussians
from tests.engine.training.adam_from_gradients import AdamFromGradients
from tests.engine.training.hidden import SIZE, keeps_what_others_hide, render

Adam = TypeVar("Adam", bound=VisibleAdam)


def adam(kind: type[Adam] = VisibleAdam, dtype: torch.dtype = torch.float32) -> Adam:
    """Of Gaussians of which every second one is behind the camera."""
    tensors = [p.to(dtype) for p in gaussians(300, raw=True)]
    tensors[0][::2, 2] -= 100.0
    parameters = zip(NAMES, tensors, strict=True)
    return kind({name: (p, 0.01) for name, p in parameters})


def after_a_step(
    weights: Tensor, row_rates: Tensor | None = None
) -> tuple[VisibleAdam, RenderOutput]:
    """`weights` (H, W, 1) are the gradient of the image."""
    optimizer = adam()
    optimizer.row_rates = row_rates
    output = render(optimizer)
    (output.image * weights).sum().backward()
    return optimizer, output


def after_gradients(weights: Tensor, row_rates: Tensor | None = None) -> AdamFromGradients:
    """The same by gradients, and a step from these."""
    optimizer = adam(AdamFromGradients)
    optimizer.row_rates = row_rates
    output = render(optimizer, backward_step=None)
    (output.image * weights).sum().backward()
    optimizer.step(output.visible[0])
    return optimizer


def test_no_gradient_is_kept_and_rows_out_of_view_stay() -> None:
    start = adam()
    optimizer, output = after_a_step(torch.ones(*SIZE[::-1], 1))
    seen = output.visible[0]
    assert seen.any() and not seen[::2].any()
    assert optimizer.step_count == 1
    for name, parameter in optimizer.parameters.items():
        assert parameter.grad is None
        before = start.parameters[name]
        assert torch.equal(parameter[~seen], before[~seen]), name
        assert not torch.equal(parameter[seen], before[seen]), name


def test_what_others_hide_keeps_values_and_moments(isa: str) -> None:
    keeps_what_others_hide("cpu")


def test_broken_rows_are_skipped_as_by_a_step() -> None:
    weights = torch.ones(*SIZE[::-1], 1)
    weights[20, 30] = torch.inf
    fused, output = after_a_step(weights)
    apart = after_gradients(weights)
    visible = int(output.visible.sum())
    assert 0 < fused.skipped_rows == apart.skipped_rows < len(NAMES) * visible
    for name, parameter in fused.parameters.items():
        assert parameter.isfinite().all()
        assert torch.equal(parameter, apart.parameters[name]), name


def test_rows_learn_as_much_faster_as_in_a_step() -> None:
    weights, rates = torch.ones(*SIZE[::-1], 1), 1.0 + (torch.arange(300) // 3 % 4)
    fused, output = after_a_step(weights, rates)
    apart = after_gradients(weights, rates)
    plain, _ = after_a_step(weights)
    faster = output.visible[0] & (rates > 1)
    for name, parameter in fused.parameters.items():
        assert torch.equal(parameter, apart.parameters[name]), name
        same = (parameter == plain.parameters[name]).reshape(300, -1).all(dim=1)
        assert not same[faster].any() and same[~faster].all(), name


def test_harmonics_that_are_not_drawn_stay() -> None:
    optimizer = adam()
    (render(optimizer).image.sum()).backward()
    before = {name: parameter.clone() for name, parameter in optimizer.parameters.items()}
    output = render(optimizer, sh_degree=1)
    output.image.sum().backward()
    seen, sh = output.visible[0], optimizer.parameters["sh"]
    assert torch.equal(sh[:, 4:], before["sh"][:, 4:])
    assert optimizer.exp_avg["sh"][seen, 4:].any()  # they would have moved on
    assert not (sh == before["sh"])[seen, :4].all(dim=(1, 2)).any()
    assert not torch.equal(optimizer.parameters["means"], before["means"])


def test_rendering_alone_takes_no_step() -> None:
    optimizer = adam()
    with torch.no_grad():
        render(optimizer)
    render(optimizer)
    assert optimizer.step_count == 0


def test_a_second_backward_is_refused() -> None:
    loss = render(adam()).image.sum()
    loss.backward(retain_graph=True)
    with pytest.raises(EngineError, match="only once"):
        loss.backward()


def test_a_step_that_cannot_be_taken_is_refused() -> None:
    with pytest.raises(EngineError, match="2 cameras"):
        render(adam(), views=2)
    with pytest.raises(EngineError, match="reference backend"):
        render(adam(), backend="reference")
    with pytest.raises(EngineError, match="reference backend"):
        render(adam(dtype=torch.float64))
    with pytest.raises(EngineError, match="not the tensors"):
        render(adam(), backward_step=adam().backward_step)
