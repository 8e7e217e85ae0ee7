"""Where blending ends: behind Gaussians that let hardly any light through (`min_transmittance`)."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize.limits import NO_LIMITS, TRAINING_LIMITS, Limits
from tests.engine.rasterize_cases import cameras, gaussians

SIZE = (80, 48)


def layers(opacity: float) -> tuple[list[Tensor], Tensor, Tensor]:
    """Four walls that fill the picture, one behind the other; a camera."""
    means = torch.tensor([[0.0, 0.0, z] for z in (4.0, 5.0, 6.0, 7.0)])
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(4, 1)
    scales = torch.tensor([[50.0, 50.0, 0.01]]).repeat(4, 1)
    parameters = [means, quats, scales, torch.full((4,), opacity), torch.ones(4, 1, 3)]
    return parameters, torch.eye(4)[None], cameras(*SIZE)[1][:1]


@pytest.mark.parametrize(
    ("limits", "drawn"), [(NO_LIMITS, [1, 1, 1, 1]), (TRAINING_LIMITS, [1, 1, 0, 0])]
)
def test_what_hardly_any_light_reaches_is_not_drawn(
    isa: str, limits: Limits, drawn: list[int]
) -> None:
    parameters, view, intrinsics = layers(opacity=0.98)  # 0.02, then 4e-4, are left behind them
    leaves = [p.requires_grad_() for p in parameters]
    rasterize(*leaves, view, intrinsics, *SIZE, limits=limits).image.sum().backward()
    gradient = leaves[4].grad
    assert gradient is not None
    seen = (gradient.abs().sum(dim=(1, 2)) > 0).int().tolist()
    assert seen == drawn


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
