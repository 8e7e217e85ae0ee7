"""The backends for GPUs give the reference's images and float64 gradients.

The CUDA kernels are run by the shim, the compute shaders by a processor that plays a GPU.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

from roigs_engine.cuda import card
from roigs_engine.errors import KernelError
from roigs_engine.gpu.program import close_gpu, open_gpu
from roigs_engine.rasterize import RenderOutput, cuda, gpu, rasterize
from roigs_engine.rasterize.limits import NO_LIMITS, TRAINING_LIMITS, Limits
from tests.engine.cuda.shim import ShimProgram, compiled
from tests.engine.gpu.software import software_adapter
from tests.engine.rasterize.walls import behind_a_haze, with_gradient
from tests.engine.rasterize_cases import (
    BACKGROUND,
    cameras,
    differentiate,
    dots_to_needles,
    gaussians,
    gradient_errors,
    largest_difference,
    relative_error,
    ring,
)

TOLERANCE = 1e-4
OUTPUTS = {"with_depth": True, "with_max_weight": True, "with_weight_sum": True}


@pytest.fixture(params=["cuda", "gpu"], autouse=True)
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Each of them, ready to draw."""
    if request.param == "cuda":
        program = ShimProgram(compiled())
        monkeypatch.setattr(card, "program", lambda device: program)
    else:
        open_gpu(software_adapter().name)
    yield request.param
    close_gpu()


def both(
    backend: str, parameters: list[Tensor], size: tuple[int, int], **options: Any
) -> tuple[RenderOutput, RenderOutput, dict[str, float]]:
    """Our output, the true one, and the errors of the gradients."""
    scene = (parameters, *cameras(*size), *size)
    truth, right = differentiate("reference", torch.float64, *scene, **options)
    ours, gradients = differentiate(backend, torch.float32, *scene, **options)
    return ours, truth, gradient_errors(gradients, right)


def agree(ours: RenderOutput, truth: RenderOutput, errors: dict[str, float]) -> None:
    assert torch.equal(ours.visible, truth.visible)
    for name in ("image", "alpha", "depth", "max_weight"):
        expected = getattr(truth, name)
        if expected is not None and getattr(ours, name) is not None:
            scale = 10.0 if name == "depth" else 1.0  # depths are about 4
            assert largest_difference(getattr(ours, name), expected) < scale * TOLERANCE, name
    if ours.surface is not None and truth.surface is not None:
        for part, expected in zip(ours.surface, truth.surface, strict=True):
            assert largest_difference(part, expected) < 10 * TOLERANCE
    if ours.weight_sum is not None and truth.weight_sum is not None:
        assert relative_error(ours.weight_sum, truth.weight_sum) < TOLERANCE
    assert relative_error(ours.grad2d, truth.grad2d) < TOLERANCE
    assert max(errors.values()) < TOLERANCE, errors


CASES: dict[str, dict[str, Any]] = {
    "raw": {"raw": True},
    "background": {"background": BACKGROUND, **OUTPUTS},
    "lower degree": {"sh_degree": 1},
    "rectangle": {"mask": (20, 20, 40, 30), "background": BACKGROUND, **OUTPUTS},
    "mask": {"mask": ring(), "background": BACKGROUND, **OUTPUTS},
    "limits": {"limits": Limits(max_slope=0.6, min_sigmas=2.0)},
    "pixel size": {"pixel_size": 2.0, **OUTPUTS},
    "linear light": {"linear_light": True, "background": BACKGROUND, **OUTPUTS},
    "raw, pixel size": {"pixel_size": 2.0, "raw": True},
    "surface": {"with_surface": True, **OUTPUTS},
    "raw, masked surface": {"with_surface": True, "raw": True, "mask": ring()},
}


@pytest.mark.parametrize("name", CASES)
def test_cases(backend: str, name: str) -> None:
    options = CASES[name]
    agree(*both(backend, gaussians(150, raw=options.get("raw", False)), (61, 43), **options))


@pytest.mark.parametrize(
    ("limits", "reached"), [(NO_LIMITS, [1, 1, 1, 1]), (TRAINING_LIMITS, [1, 1, 0, 1])]
)
def test_what_adds_hardly_anything_gets_no_gradient(
    backend: str, limits: Limits, reached: list[int]
) -> None:
    assert with_gradient([0.95, 0.95, 0.2, 0.9], limits, backend) == reached


def test_what_gets_no_gradient_still_hides_what_is_behind(backend: str) -> None:
    ours, truth = behind_a_haze(backend)
    assert ours == pytest.approx(truth, rel=1e-3)


@pytest.mark.parametrize("coefficients", [1, 4, 9])
def test_fewer_bands(backend: str, coefficients: int) -> None:
    agree(*both(backend, gaussians(60, coefficients=coefficients), (40, 30)))


@pytest.mark.parametrize("size", [(1, 1), (3, 40), (16, 16), (17, 5), (64, 33)])
def test_image_sizes(backend: str, size: tuple[int, int]) -> None:
    agree(*both(backend, gaussians(80, coefficients=4), size, **OUTPUTS))


@pytest.mark.parametrize("seed", range(4))
def test_random_scenes(backend: str, seed: int) -> None:
    count, size = (35, 100, 300, 500)[seed], (0.5, 0.2, 0.05, 0.1)[seed]
    parameters = gaussians(count, coefficients=4, size=size, seed=seed + 1)
    parameters[0][:, 2] -= 2.0  # some are behind the camera
    agree(*both(backend, parameters, (33, 20)))


@pytest.mark.parametrize("backend", ["cuda"], indirect=True)
def test_more_tiles_than_16_bits_count(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "SHORT_TILES", 3)
    agree(*both(backend, gaussians(60, coefficients=1), (40, 30)))


@pytest.mark.parametrize("backend", ["cuda"], indirect=True)
def test_more_pairs_than_32_bits_count(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "_MOST_PAIRS", 20)
    with pytest.raises(KernelError, match="pairs of Gaussians and tiles"):
        rasterize(*gaussians(60), *cameras(40, 30), 40, 30, backend=backend)


@pytest.mark.parametrize("backend", ["gpu"], indirect=True)
def test_what_its_buffers_do_not_hold_is_drawn_by_the_processor(
    backend: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = (gaussians(60), *cameras(40, 30), 40, 30)
    there, gradients = differentiate(backend, torch.float32, *scene)
    cpu, right = differentiate("cpu", torch.float32, *scene)
    monkeypatch.setattr(gpu, "most_pairs", lambda largest, tiles: 20)
    found, others = differentiate(backend, torch.float32, *scene)
    assert torch.equal(found.image, cpu.image) and not torch.equal(there.image, cpu.image)
    assert all(map(torch.equal, others, right)) and not all(map(torch.equal, gradients, right))


def test_it_takes_float32_only(backend: str) -> None:
    parameters = [p.double() for p in gaussians(3)]
    with pytest.raises(KernelError, match=rf"{backend} backend does not take torch\.float64"):
        rasterize(*parameters, *(c.double() for c in cameras(9, 9)), 9, 9, backend=backend)


def test_many_opaque_layers(backend: str) -> None:
    """More than a group in a tile, and pixels that end early."""
    parameters = gaussians(1200, coefficients=1, size=0.5)
    ours, truth, errors = both(backend, parameters, (16, 12), with_weight_sum=True)
    assert float((truth.alpha > 1 - 1e-6).double().mean()) > 0.5
    agree(ours, truth, errors)


def test_blending_ends_where_little_light_is_left(backend: str) -> None:
    leaves = [p.requires_grad_() for p in gaussians(1200, coefficients=1, size=0.5)]
    scene = (*cameras(16, 12), 16, 12)
    exact = rasterize(*leaves, *scene, backend=backend)
    rough = rasterize(*leaves, *scene, backend=backend, limits=TRAINING_LIMITS)
    assert 0 < largest_difference(rough.image, exact.image) < 5e-3
    reached = []
    for output in (exact, rough):
        leaves[4].grad = None
        output.image.sum().backward()
        assert leaves[4].grad is not None
        reached.append(int((leaves[4].grad != 0).sum()))
    assert 0 < reached[1] < reached[0]


def test_shapes_from_dots_to_needles(backend: str) -> None:
    parameters = dots_to_needles(100)
    scene = (parameters, *cameras(61, 43), 61, 43)
    ours, truth, errors = both(backend, parameters, (61, 43))
    assert torch.equal(ours.visible, truth.visible)
    assert largest_difference(ours.image, truth.image) < 1e-3
    # What float32 can give here is less than elsewhere; the kernels are not to fall behind it.
    _, single = differentiate("reference", torch.float32, *scene)
    _, double = differentiate("reference", torch.float64, *scene)
    limits = gradient_errors(single, double)
    assert all(error < limits[name] + TOLERANCE for name, error in errors.items()), errors


@pytest.mark.parametrize("raw", [False, True])
def test_nan_is_not_drawn(backend: str, raw: bool) -> None:
    sound = gaussians(60, raw=raw)
    broken = [p.clone() for p in sound]
    for row, p in enumerate(broken):
        p[row].view(-1)[0] = float("nan")
    scene = (*cameras(40, 40), 40, 40)
    ours, gradients = differentiate(backend, torch.float32, broken, *scene, raw=raw)
    rest = [p[5:] for p in sound]
    alone, right = differentiate(backend, torch.float32, rest, *scene, raw=raw)
    assert not ours.visible[:, :5].any()
    assert torch.equal(ours.image, alone.image)
    for mine, theirs in zip(gradients, right, strict=True):
        assert torch.equal(mine[5:], theirs) and not mine[:5].any()


def test_median_depth(backend: str) -> None:
    scene = (*gaussians(150, coefficients=1), *cameras(61, 43), 61, 43)
    truth = rasterize(*scene, with_depth="median", backend="cpu")
    ours = rasterize(*scene, with_depth="median", backend=backend)
    assert ours.depth is not None and truth.depth is not None
    other = (ours.depth - truth.depth).abs() > 1e-3
    assert float(other.double().mean()) < 1e-3  # rounding may pick the Gaussian next to it


@pytest.mark.parametrize(("count", "region"), [(0, None), (9, (0, 0, 0, 0)), (9, (70, 0, 90, 20))])
def test_where_nothing_is_drawn_there_is_the_background(
    backend: str, count: int, region: tuple[int, int, int, int] | None
) -> None:
    leaves = [p.requires_grad_() for p in gaussians(count)]
    output = rasterize(
        *leaves, *cameras(61, 43), 61, 43, background=BACKGROUND, mask=region, backend=backend
    )
    output.image.sum().backward()
    assert torch.equal(output.image, BACKGROUND.expand(2, 43, 61, 3))
    assert not output.visible.any() and not output.alpha.any()


def test_gradients_are_added_to_those_that_are_there(backend: str) -> None:
    scene = (*cameras(40, 30), 40, 30)
    parameters = gaussians(30)
    _, once = differentiate(backend, torch.float32, parameters, *scene)
    leaves = [p.clone().requires_grad_() for p in parameters]
    for leaf in leaves:
        leaf.grad = torch.ones_like(leaf)
    output = rasterize(*leaves, *scene, backend=backend)
    weights = torch.randn(output.image.shape, generator=torch.Generator().manual_seed(1))
    loss = (output.image * weights).sum()
    loss.backward(retain_graph=True)
    for leaf, gradient in zip(leaves, once, strict=True):
        assert leaf.grad is not None
        assert torch.allclose(leaf.grad, gradient + 1, rtol=1e-4, atol=1e-5)
    loss.backward()
    for leaf, gradient in zip(leaves, once, strict=True):
        assert leaf.grad is not None
        assert torch.allclose(leaf.grad, 2 * gradient + 1, rtol=1e-4, atol=1e-5)


def test_the_same_bits_every_time(backend: str) -> None:
    scene = (gaussians(200, coefficients=4), *cameras(40, 30), 40, 30)
    first, second = (differentiate(backend, torch.float32, *scene) for _ in range(2))
    for mine, theirs in zip(first[1], second[1], strict=True):
        assert torch.equal(mine, theirs)
