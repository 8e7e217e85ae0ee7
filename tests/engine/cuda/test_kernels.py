"""The Triton kernels, run by Triton's interpreter on the CPU; skipped where Triton is missing."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest
import torch

from roigs_engine.cuda import library
from roigs_engine.rasterize import rasterize
from roigs_engine.training.optimizer import VisibleAdam
from tests.engine import fake_gsplat
from tests.engine.rasterize.test_gsplat import ring
from tests.engine.rasterize_cases import cameras, gaussians, relative_error

if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"  # read when Triton is imported
pytest.importorskip("triton")
SIZE = (61, 43)


@pytest.fixture(scope="module", autouse=True)
def _interpreted() -> Iterator[None]:
    if torch.cuda.is_available():
        pytest.skip("on a card its own tests run the compiled kernels")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(library, "gsplat", lambda: fake_gsplat)
        yield


@pytest.mark.parametrize("masked", [False, True])
def test_weights_are_those_of_the_reference(masked: bool) -> None:
    scene = (gaussians(30, size=0.2), *cameras(*SIZE), *SIZE)
    pixel_weights = torch.rand(2, SIZE[1], SIZE[0], generator=torch.Generator().manual_seed(2))
    options = {
        "mask": ring() if masked else (20, 10, 50, 43),
        "with_max_weight": True,
        "with_weight_sum": True,
        "pixel_weights": pixel_weights,
    }
    truth = rasterize(*scene[0], *scene[1:], **options, backend="reference")
    ours = rasterize(*scene[0], *scene[1:], **options, backend="gsplat")
    assert truth.max_weight is not None and truth.max_weight.max() > 0.5
    assert (ours.max_weight - truth.max_weight).abs().max() < 1e-5
    assert relative_error(ours.weight_sum, truth.weight_sum) < 1e-5


def test_opaque_layers_end_a_pixel_as_in_the_picture() -> None:
    """Behind light of 1e-4 nothing has a weight; the sum of weights is the picture's alpha."""
    means, quats, scales, opacities, sh = gaussians(24, size=1.5)
    scene = (means, quats, scales, torch.full_like(opacities, 0.9), sh)
    output = rasterize(
        *scene, *(c[:1] for c in cameras(*SIZE)), *SIZE, with_weight_sum=True, backend="gsplat"
    )
    assert output.alpha.max() > 0.999
    assert output.weight_sum is not None
    assert float(output.weight_sum.sum()) == pytest.approx(float(output.alpha.sum()), rel=1e-5)


def test_adam_is_that_of_the_reference() -> None:
    generator = torch.Generator().manual_seed(0)
    shapes = {"means": (70, 3), "logits": (70,), "sh": (70, 16, 3)}
    first = {n: torch.randn(s, generator=generator) for n, s in shapes.items()}
    rates = {"means": 1e-2, "logits": 5e-2, "sh": torch.linspace(1e-3, 1e-2, 48)}
    both = {
        backend: VisibleAdam({n: (t.clone(), rates[n]) for n, t in first.items()}, backend=backend)
        for backend in ("cuda", "reference")
    }
    for step in range(4):
        if step == 2:
            for optimizer in both.values():
                optimizer.row_rates = 1.0 + (torch.arange(70) % 3)
        visible = torch.rand(70, generator=generator) < 0.6
        gradients = {n: torch.randn(s, generator=generator) for n, s in shapes.items()}
        gradients["sh"][5 + step, 7, 1] = torch.nan
        gradients["means"][9, 2] = torch.inf
        for optimizer in both.values():
            for name, gradient in gradients.items():
                row = (-1,) + (1,) * (gradient.dim() - 1)
                optimizer.parameters[name].grad = torch.where(visible.view(row), gradient, 0)
            optimizer.step(visible)
    triton, reference = both.values()
    assert int(triton.skipped_rows) == int(reference.skipped_rows) > 0
    for name in shapes:
        for field in ("parameters", "exp_avg", "exp_avg_sq"):
            ours, truth = getattr(triton, field)[name], getattr(reference, field)[name]
            assert torch.allclose(ours, truth, rtol=1e-5, atol=1e-7), (name, field)
        assert triton.parameters[name].grad is None  # the next one is taken as it comes
