"""The end of blending: behind Gaussians that let hardly any light through (`min_transmittance`)."""

from __future__ import annotations

import pytest
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize.limits import NO_LIMITS, TRAINING_LIMITS, Limits
from tests.engine.rasterize.walls import SIZE, behind_a_haze, with_gradient
from tests.engine.rasterize_cases import cameras, gaussians, relative_error


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


def test_less_than_none() -> None:
    with pytest.raises(EngineError, match="min_transmittance -1 is not 0 or more"):
        Limits(min_transmittance=-1)
