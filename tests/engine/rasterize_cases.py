"""Scenes, cameras and comparisons for the tests of the rasterizer."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from roigs_engine.rasterize import RenderOutput, rasterize

# Where cores are shared, torch's threads wait for each other longer than such small tensors take.
torch.set_num_threads(1)

NAMES = ("means", "quats", "scales", "opacities", "sh")
BACKGROUND = torch.tensor([0.2, 0.5, 0.9])
SIZE = (61, 43)  # of pictures: no multiple of a tile


def gaussians(
    count: int, *, coefficients: int = 16, raw: bool = False, size: float = 0.13, seed: int = 0
) -> list[Tensor]:
    """A cloud around (0, 0, 4), float32: means, quats, scales, opacities, sh."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    means = normal(count, 3) + torch.tensor([0.0, 0.0, 4.0])
    quats = 3.0 * normal(count, 4)
    scales = 0.5 * normal(count, 3) + math.log(size)
    opacities = 1.5 * normal(count)
    if not raw:
        scales, opacities = scales.exp(), opacities.sigmoid()
    return [means, quats, scales, opacities, 0.3 * normal(count, coefficients, 3)]


def dots_to_needles(count: int) -> list[Tensor]:
    """`gaussians` of five extreme shapes; a multiple of five of them."""
    parameters = gaussians(count, coefficients=1)
    parameters[2] = torch.tensor(
        [[1e-9, 1e-9, 1e-9], [1e-5, 1e-5, 3.0], [0.2, 0.2, 1e-8], [30.0, 1e-3, 1e-3], [20, 20, 20]]
    ).repeat(count // 5, 1)
    return parameters


def cameras(width: int, height: int) -> tuple[Tensor, Tensor]:
    """Two cameras that differ in rotation and place; fx != fy, principal point off the centre."""
    views = torch.eye(4).repeat(2, 1, 1)
    yaw, pitch = 0.3, 0.2
    about_y = torch.tensor(
        [
            [math.cos(yaw), 0.0, math.sin(yaw)],
            [0.0, 1.0, 0.0],
            [-math.sin(yaw), 0.0, math.cos(yaw)],
        ]
    )
    about_x = torch.tensor(
        [
            [1.0, 0.0, 0.0],
            [0.0, math.cos(pitch), -math.sin(pitch)],
            [0.0, math.sin(pitch), math.cos(pitch)],
        ]
    )
    views[1, :3, :3] = about_y @ about_x
    views[1, :3, 3] = torch.tensor([-0.8, 0.1, 0.6])
    size = max(width, height)
    intrinsics = torch.tensor(
        [[1.0 * size, 0.0, 0.55 * width], [0.0, 1.15 * size, 0.42 * height], [0.0, 0.0, 1.0]]
    )
    return views, intrinsics.repeat(2, 1, 1)


def ring() -> Tensor:
    """A bool mask of `SIZE` with a hole."""
    mask = torch.zeros(SIZE[1], SIZE[0], dtype=torch.bool)
    mask[2:40, 18:60] = True
    mask[17:30, 33:47] = False
    return mask


CASES: dict[str, dict[str, Any]] = {
    "plain": {},
    "background": {"background": BACKGROUND},
    "lower degree": {"sh_degree": 1},
    "rectangle": {"mask": (20, 20, 40, 30), "background": BACKGROUND},
    "mask": {"mask": ring(), "background": BACKGROUND, "with_depth": True},
    "depth": {"with_depth": True},
    "surface": {"with_surface": True, "mask": ring(), "background": BACKGROUND},
    "pixel size": {"pixel_size": 2.0},
    "anti-aliased": {"antialiased": True},
    "linear light": {"linear_light": True, "background": BACKGROUND},
}
"""Options of `rasterize`, by name, for pictures of `SIZE`."""


def render_both(
    parameters: list[Tensor],
    views: Tensor,
    intrinsics: Tensor,
    width: int,
    height: int,
    **options: Any,
) -> tuple[RenderOutput, RenderOutput, dict[str, float]]:
    """Renders with the cpu backend and with the reference in float64, and differentiates both.

    Returns both outputs and the relative L2 error of each parameter's gradient, for a random
    linear function of the image.
    """
    arguments = (parameters, views, intrinsics, width, height)
    truth, true_gradients = differentiate("reference", torch.float64, *arguments, **options)
    ours, gradients = differentiate("cpu", torch.float32, *arguments, **options)
    return ours, truth, gradient_errors(gradients, true_gradients)


def differentiate(
    backend: str,
    dtype: torch.dtype,
    parameters: list[Tensor],
    views: Tensor,
    intrinsics: Tensor,
    width: int,
    height: int,
    **options: Any,
) -> tuple[RenderOutput, list[Tensor]]:
    """A rendering, and the parameters' gradients of a random linear function of its image.

    And of its alpha and surface, if it has one.
    """
    key = _content((dtype, parameters, views, intrinsics, width, height, options))
    if backend == "reference" and key in _REFERENCES:  # slow, and asked for by each test of a case
        return _REFERENCES[key]
    leaves = [p.to(dtype, copy=True).requires_grad_() for p in parameters]
    cameras = views.to(dtype), intrinsics.to(dtype)
    output = rasterize(*leaves, *cameras, width, height, backend=backend, **options)
    shown = (
        [output.image] if output.surface is None else [output.image, output.alpha, *output.surface]
    )
    generator = torch.Generator().manual_seed(1)
    weights = [torch.randn(each.shape, generator=generator).to(dtype) for each in shown]
    sums = [(each * weight).sum() for each, weight in zip(shown, weights, strict=True)]
    torch.stack(sums).sum().backward()
    result = output, [p.grad for p in leaves if p.grad is not None]
    if backend == "reference":
        _REFERENCES[key] = result
    return result


_REFERENCES: dict[str, tuple[RenderOutput, list[Tensor]]] = {}


def _content(value: Any) -> str:
    """Equal for equal values; tensors by their bytes (pickles of equal ones differ)."""
    if isinstance(value, Tensor):
        return f"{value.dtype}{tuple(value.shape)}{value.detach().contiguous().numpy().tobytes()!r}"
    if isinstance(value, dict):
        return repr({name: _content(item) for name, item in value.items()})
    return repr([_content(item) for item in value] if isinstance(value, list | tuple) else value)


def gradient_errors(gradients: list[Tensor], truth: list[Tensor]) -> dict[str, float]:
    """Relative L2 error per parameter."""
    pairs = zip(NAMES, gradients, truth, strict=True)
    return {name: relative_error(ours, theirs) for name, ours, theirs in pairs}


def relative_error(value: Tensor, truth: Tensor) -> float:
    """|value - truth| / |truth| in the Euclidean norm; 0 when both are zero."""
    value, truth = value.detach().double(), truth.detach().double()
    return float((value - truth).norm()) / max(float(truth.norm()), 1e-30)


def largest_difference(value: Tensor | None, truth: Tensor | None) -> float:
    """max |value - truth|."""
    assert value is not None and truth is not None
    return float((value.detach().double() - truth.detach().double()).abs().max())


def assert_matches(*, raw: bool, **options: Any) -> None:
    """The kernels and the reference agree in all that they return, and in the gradients."""
    ours, truth, errors = render_both(
        gaussians(150, raw=raw, size=0.03, seed=1),
        *cameras(61, 43),
        61,
        43,
        raw=raw,
        background=BACKGROUND,
        with_max_weight=True,
        **options,
    )
    assert torch.equal(ours.visible, truth.visible)
    assert largest_difference(ours.image, truth.image) < 1e-4
    assert largest_difference(ours.max_weight, truth.max_weight) < 1e-4
    assert relative_error(ours.grad2d, truth.grad2d) < 1e-4
    assert max(errors.values()) < 1e-4, errors
