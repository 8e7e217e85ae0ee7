"""Promises of `rasterize` besides numbers: bad input, memory, threads, gradients."""

from __future__ import annotations

import gc
from typing import Any

import pytest
import torch
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.kernels import library
from roigs_engine.rasterize import RenderOutput, cpu, rasterize
from roigs_engine.rasterize.inputs import Depth
from tests.engine.rasterize_cases import BACKGROUND, NAMES, cameras, gaussians

SIZE = (61, 43)


def render(parameters: list[Tensor], **options: Any) -> RenderOutput:
    return rasterize(*parameters, *cameras(*SIZE), *SIZE, **options)


def leaves(count: int = 200, **options: Any) -> list[Tensor]:
    return [p.requires_grad_() for p in gaussians(count, **options)]


def dense_gradients(parameters: list[Tensor]) -> list[Tensor]:
    fresh = [p.detach().clone().requires_grad_() for p in parameters]
    render(fresh).image.square().sum().backward()
    return [p.grad for p in fresh if p.grad is not None]


# --- where gradients go ---


def test_allocated_grads_are_added_to_in_place() -> None:
    parameters = leaves()
    expected = dense_gradients(parameters)
    for p in parameters:
        p.grad = torch.full_like(p, 2.0)
    buffers = [p.grad for p in parameters]
    render(parameters).image.square().sum().backward()
    for p, buffer, gradient in zip(parameters, buffers, expected, strict=True):
        assert p.grad is buffer
        torch.testing.assert_close(buffer, gradient + 2.0)


def test_rows_out_of_view_are_not_touched() -> None:
    parameters = leaves()
    with torch.no_grad():
        parameters[0][::2, 2] -= 100.0
    for p in parameters:
        p.grad = torch.zeros_like(p)
        p.grad[::2] = torch.nan
    output = render(parameters)
    output.image.square().sum().backward()
    assert not output.visible[:, ::2].any()
    for p in parameters:
        assert p.grad is not None
        assert torch.isnan(p.grad[::2]).all() and torch.isfinite(p.grad[1::2]).all()


def test_inputs_that_are_not_leaves_get_dense_gradients() -> None:
    stored = leaves()
    expected = dense_gradients(stored)
    render([p * 1.0 for p in stored]).image.square().sum().backward()
    for p, gradient in zip(stored, expected, strict=True):
        torch.testing.assert_close(p.grad, gradient)


def test_inputs_that_need_no_gradient_get_none() -> None:
    parameters = gaussians(200)
    parameters[4].requires_grad_()
    render(parameters).image.square().sum().backward()
    assert [p.grad is not None for p in parameters] == [False, False, False, False, True]
    torch.testing.assert_close(parameters[4].grad, dense_gradients(parameters)[4])


def test_strided_inputs() -> None:
    parameters = gaussians(200)
    expected = dense_gradients(parameters)
    wide = [torch.cat([p, p], dim=-1) for p in parameters]
    strided = [w[..., : p.shape[-1]] for w, p in zip(wide, parameters, strict=True)]
    strided[3] = wide[3][:200]
    inputs = [s.detach().requires_grad_() for s in strided]
    render(inputs).image.square().sum().backward()
    for p, gradient in zip(inputs, expected, strict=True):
        torch.testing.assert_close(p.grad, gradient)


def test_backward_twice_through_one_graph() -> None:
    parameters = leaves()
    loss = render(parameters).image.square().sum()
    loss.backward(retain_graph=True)
    once = [p.grad.clone() for p in parameters if p.grad is not None]
    render(gaussians(300, seed=5))  # takes over the memory of the first rendering
    for p in parameters:
        p.grad = None
    loss.backward()
    for p, gradient in zip(parameters, once, strict=True):
        assert torch.equal(p.grad, gradient)


def test_two_renderings_before_their_backwards() -> None:
    first, second = leaves(), leaves(seed=3)
    expected = dense_gradients(first)
    loss_first = render(first).image.square().sum()
    loss_second = render(second).image.square().sum()
    (loss_first + loss_second).backward()
    for p, gradient in zip(first, expected, strict=True):
        assert torch.equal(p.grad, gradient)


def test_grad2d_is_zero_until_backward() -> None:
    output = render(leaves())
    assert not output.grad2d.any()
    output.image.sum().backward()
    assert torch.equal(output.grad2d > 0, output.grad2d.bool() & output.visible)
    assert int((output.grad2d > 0).sum()) > 100


def test_image_is_planar_inside() -> None:
    """The loss can take the image, and hand its gradient back, without a copy."""
    assert render(leaves()).image.permute(0, 3, 1, 2).is_contiguous()


# --- threads and memory ---


def test_same_bits_at_any_number_of_threads() -> None:
    """Also where many Gaussians have the same depth."""
    parameters = gaussians(40_000, coefficients=4, size=0.02)
    parameters[0][:, 2] = (parameters[0][:, 2] * 20).round() / 20
    results = []
    try:
        for threads in (1, 2, 3):
            library.set_threads(threads)
            inputs = [p.clone().requires_grad_() for p in parameters]
            output = render(inputs, with_max_weight=True, with_depth=True)
            output.image.square().sum().backward()
            median = render(parameters, with_depth="median").depth
            assert output.depth is not None and output.max_weight is not None
            assert median is not None
            tensors = [output.image, output.depth, median, output.max_weight, output.grad2d]
            results.append([*tensors, *(p.grad for p in inputs if p.grad is not None)])
    finally:
        library.set_threads(None)
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_views_are_used_again() -> None:
    cpu.KernelView._idle.clear()
    parameters = leaves()
    for _ in range(3):
        render([p.detach() for p in parameters])
        render(parameters).image.sum().backward()
        render(parameters)  # dropped without a backward
    gc.collect()
    assert len(cpu.KernelView._idle) <= cpu.KernelView._MOST_IDLE
    kept = set(map(id, cpu.KernelView._idle))
    render(parameters).image.sum().backward()
    assert kept == set(map(id, cpu.KernelView._idle))


# --- degenerate scenes ---


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("with_depth", [True, "median"])
def test_nothing_to_draw(backend: str, with_depth: Depth) -> None:
    behind = leaves()
    with torch.no_grad():
        behind[0][:, 2] -= 100.0
    for parameters in (leaves(0), behind):
        output = render(
            parameters,
            background=BACKGROUND,
            with_depth=with_depth,
            with_max_weight=True,
            backend=backend,
        )
        assert torch.equal(output.image, BACKGROUND.expand(output.image.shape))
        assert not output.alpha.any() and not output.visible.any()
        assert output.depth is not None and not output.depth.any()
        if output.image.requires_grad:
            output.image.sum().backward()
        for p in parameters:
            assert p.grad is None or not p.grad.any()


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e30])
@pytest.mark.parametrize("raw", [False, True])
def test_broken_gaussians_disturb_nobody(backend: str, value: float, raw: bool) -> None:
    sound = gaussians(200, raw=raw)
    broken = [p.clone() for p in sound]
    rows = range(0, 50, 10)
    for row, p in zip(rows, broken, strict=True):
        p[row].view(-1)[0] = value
    broken[1][60] = 0.0  # a quaternion without direction
    kept = torch.ones(200, dtype=torch.bool)
    kept[[*rows, 60]] = False
    if value == 1e30:  # huge numbers are finite: an opacity far above 1, a colour, a quaternion
        kept[[10, 30, 40]] = True
    inputs = [p.clone().requires_grad_() for p in broken]
    output = render(inputs, raw=raw, backend=backend)
    if value == 1e30:
        assert torch.isfinite(output.image[..., 1:]).all()
        return
    expected = render([p[kept] for p in sound], raw=raw, backend=backend)
    if raw and value == float("inf"):
        return  # exp(inf) and sigmoid(inf) have limits; checked for not crashing
    assert torch.equal(output.image, expected.image)
    output.image.square().sum().backward()
    for name, p in zip(NAMES, inputs, strict=True):
        assert p.grad is not None and torch.isfinite(p.grad).all(), name
        assert not p.grad[~kept].any(), name


@pytest.mark.parametrize("seed", range(6))
def test_extreme_values_anywhere(seed: int) -> None:
    """Image and gradients stay finite whatever the parameters hold, but for huge colours."""
    generator = torch.Generator().manual_seed(seed)
    nan, inf = float("nan"), float("inf")
    extremes = torch.tensor([nan, inf, -inf, 0.0, 1e-20, 1e-40, 1e38, -1e38, 1e20, 1e10])
    parameters = gaussians(500, raw=seed % 2 == 0, seed=seed)
    for name, p in zip(NAMES, parameters, strict=True):
        kinds = 6 if name == "sh" else len(extremes)
        where = torch.rand(p.shape, generator=generator) < 0.05
        p[where] = extremes[torch.randint(0, kinds, p.shape, generator=generator)][where]
        p.requires_grad_()
    output = render(parameters, raw=seed % 2 == 0, with_max_weight=True)
    output.image.clamp(-1e3, 1e3).sum().backward()
    assert torch.isfinite(output.image).all()
    for name, p in zip(NAMES, parameters, strict=True):
        assert p.grad is not None and torch.isfinite(p.grad).all(), name


@pytest.mark.parametrize("size", [(8192, 3), (3, 8192)])
def test_long_images(size: tuple[int, int]) -> None:
    parameters = leaves(50, coefficients=1, size=2.0)
    views, intrinsics = cameras(*size)
    output = rasterize(*parameters, views, intrinsics, *size)
    output.image.sum().backward()
    assert output.image.shape == (2, size[1], size[0], 3)
    assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in parameters)


# --- bad input ---


@pytest.mark.parametrize(
    ("position", "shape"), [(0, (9, 2)), (1, (8, 4)), (3, (9, 1)), (4, (9, 5, 3))]
)
def test_wrong_shapes(position: int, shape: tuple[int, ...]) -> None:
    parameters = gaussians(9)
    parameters[position] = torch.zeros(shape)
    with pytest.raises(EngineError, match="coefficients" if position == 4 else NAMES[position]):
        render(parameters)


def test_wrong_options() -> None:
    parameters = gaussians(9, coefficients=4)
    with pytest.raises(EngineError, match="sh_degree 2"):
        render(parameters, sh_degree=2)
    with pytest.raises(EngineError, match="'nearest', not a bool or 'median'"):
        render(parameters, with_depth="nearest")
    with pytest.raises(EngineError, match="backend"):
        render(parameters, backend="fast")
    with pytest.raises(EngineError, match="background"):
        render(parameters, background=torch.zeros(4))
    with pytest.raises(EngineError, match="float64"):
        render([p.double() for p in parameters], backend="cpu")
    with pytest.raises(EngineError, match="0x43"):
        rasterize(*parameters, *cameras(*SIZE), 0, 43)


def test_float64_goes_to_the_reference() -> None:
    assert render([p.double() for p in gaussians(9)]).image.dtype == torch.float64
