"""Where blending ends: behind Gaussians that let hardly any light through (`min_transmittance`)."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize.limits import NO_LIMITS, TRAINING_LIMITS, Limits
from tests.engine.rasterize_cases import cameras, gaussians, relative_error

SIZE = (80, 48)


def layers(opacities: list[float]) -> tuple[list[Tensor], Tensor, Tensor]:
    """White walls that fill the picture, one behind the other; a camera."""
    count = len(opacities)
    means = torch.tensor([[0.0, 0.0, 4.0 + 3.0 * i / (count - 1)] for i in range(count)])
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1)
    scales = torch.tensor([[50.0, 50.0, 0.01]]).repeat(count, 1)
    parameters = [means, quats, scales, torch.tensor(opacities), torch.ones(count, 1, 3)]
    return parameters, torch.eye(4)[None], cameras(*SIZE)[1][:1]


def with_gradient(opacities: list[float], limits: Limits, backend: str) -> list[int]:
    """1 for each wall that gets a gradient, else 0."""
    parameters, view, intrinsics = layers(opacities)
    leaves = [p.requires_grad_() for p in parameters]
    options: dict[str, Any] = {"limits": limits, "backend": backend}
    rasterize(*leaves, view, intrinsics, *SIZE, **options).image.sum().backward()
    gradient = leaves[4].grad
    assert gradient is not None
    return (gradient.abs().sum(dim=(1, 2)) > 0).int().tolist()


@pytest.mark.parametrize(
    ("limits", "drawn"), [(NO_LIMITS, [1, 1, 1, 1]), (TRAINING_LIMITS, [1, 1, 0, 0])]
)
def test_what_hardly_any_light_reaches_is_not_drawn(
    isa: str, limits: Limits, drawn: list[int]
) -> None:
    opacities = [0.98] * 4  # 0.02, then 4e-4 of the light are left behind them
    assert with_gradient(opacities, limits, "cpu") == drawn


@pytest.mark.parametrize(
    ("limits", "reached"), [(NO_LIMITS, [1, 1, 1, 1]), (TRAINING_LIMITS, [1, 1, 0, 1])]
)
def test_what_adds_hardly_anything_gets_no_gradient(
    isa: str, limits: Limits, reached: list[int]
) -> None:
    opacities = [0.95, 0.95, 0.2, 0.9]  # weights of 0.95, 0.05, 5e-4 and 2e-3
    assert with_gradient(opacities, limits, "cpu") == reached


def behind_a_haze(backend: str) -> tuple[float, float]:
    """The opacity gradient of a wall behind forty walls that get none, and the reference's."""
    found = []
    for name in (backend, "reference"):
        parameters, view, intrinsics = layers([0.9] + 40 * [0.0095] + [0.95])
        parameters[4][0], parameters[4][-1] = 0.5, 0.2
        opacities = parameters[3].requires_grad_()
        options: dict[str, Any] = {"limits": TRAINING_LIMITS, "backend": name}
        rasterize(*parameters, view, intrinsics, *SIZE, **options).image.mean().backward()
        assert opacities.grad is not None
        found.append(float(opacities.grad[-1]))
        hidden = opacities.grad[1:-1].any()
        assert bool(hidden) == (name == "reference")
    return found[0], found[1]


def test_what_gets_no_gradient_still_hides_what_is_behind(isa: str) -> None:
    ours, truth = behind_a_haze("cpu")
    assert ours == pytest.approx(truth, rel=1e-3)


def test_gradients_differ_by_as_little(isa: str) -> None:
    scene = (*gaussians(4000, coefficients=4, size=0.2), *cameras(*SIZE), *SIZE)

    def gradients(least: float) -> list[Tensor]:
        leaves = [p.clone().requires_grad_() for p in scene[:5]]
        limits = Limits(min_transmittance=least)
        image = rasterize(*leaves, *scene[5:], limits=limits).image
        (image - 0.5).square().sum().backward()
        return [leaf.grad for leaf in leaves if leaf.grad is not None]

    exact = gradients(0.0)
    for least in (1e-4, 1e-3):
        for rough, right in zip(gradients(least), exact, strict=True):
            assert 0 < relative_error(rough, right) < 20 * least


def test_pictures_differ_by_as_much_at_most(isa: str) -> None:
    scene = (*gaussians(4000, coefficients=4, size=0.2), *cameras(*SIZE), *SIZE)
    exact = rasterize(*scene)
    assert float(exact.alpha.median()) > 1 - 1e-4
    for least in (1e-3, 1e-2):
        rough = rasterize(*scene, limits=Limits(min_transmittance=least)).image
        brightest = 0.5 + 3 * float(scene[4].abs().max())
        assert 0 < float((rough - exact.image).abs().max()) < least * brightest


def test_it_is_no_cull() -> None:
    assert not NO_LIMITS.cull and not TRAINING_LIMITS.cull
    assert Limits(max_slope=3.0).cull and Limits(min_sigmas=1.0).cull


def test_less_than_none() -> None:
    with pytest.raises(EngineError, match="min_transmittance -1 is not 0 or more"):
        Limits(min_transmittance=-1)
