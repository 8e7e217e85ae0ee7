"""Sums of blending weights per Gaussian, over all pixels or weighted by an image."""

from __future__ import annotations

import pytest
import torch

from roigs_engine.errors import EngineError
from roigs_engine.kernels import library
from roigs_engine.rasterize import rasterize
from tests.engine.rasterize_cases import (
    cameras,
    gaussians,
    largest_difference,
    relative_error,
    render_both,
)

SIZE = (61, 43)


def pixel_weights() -> torch.Tensor:
    return torch.randn(2, SIZE[1], SIZE[0], generator=torch.Generator().manual_seed(4))


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("others", [False, True])
@pytest.mark.parametrize("size", [0.13, 2.0])  # large ones touch more tiles than a vector holds
def test_sums_match(isa: str, weighted: bool, others: bool, size: float) -> None:
    ours, truth, errors = render_both(
        gaussians(150, coefficients=1, size=size),
        *cameras(*SIZE),
        *SIZE,
        with_weight_sum=True,
        pixel_weights=pixel_weights() if weighted else None,
        with_max_weight=others,
        with_depth=others,
    )
    assert relative_error(ours.weight_sum, truth.weight_sum) < 1e-4
    assert largest_difference(ours.image, truth.image) < 1e-3
    if others:
        assert largest_difference(ours.max_weight, truth.max_weight) < 1e-3
        assert largest_difference(ours.depth, truth.depth) < 1e-2
    if size < 1.0:
        assert max(errors.values()) < 1e-4, errors


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_sums_of_all_gaussians_are_the_image_s_alpha(backend: str) -> None:
    output = rasterize(
        *gaussians(150, coefficients=1),
        *cameras(*SIZE),
        *SIZE,
        with_weight_sum=True,
        backend=backend,
    )
    assert output.weight_sum is not None
    torch.testing.assert_close(output.weight_sum.sum(), output.alpha.sum(), rtol=1e-5, atol=0.0)
    assert not output.weight_sum[~output.visible.any(dim=0)].any()


def test_many_tiles_each(isa: str) -> None:
    """More slots than any vector has lanes."""
    size = (300, 200)
    views, intrinsics = cameras(*size)
    ours, truth, _ = render_both(
        gaussians(40, coefficients=1, size=1.0),
        views[:1],
        intrinsics[:1],
        *size,
        with_weight_sum=True,
        with_max_weight=True,
    )
    assert relative_error(ours.weight_sum, truth.weight_sum) < 1e-4
    assert largest_difference(ours.max_weight, truth.max_weight) < 1e-3


def test_same_bits_at_any_number_of_threads() -> None:
    parameters = gaussians(20_000, coefficients=1, size=0.02)
    sums = []
    try:
        for threads in (1, 2, 3):
            library.set_threads(threads)
            options = {"with_weight_sum": True, "pixel_weights": pixel_weights()}
            output = rasterize(*parameters, *cameras(*SIZE), *SIZE, **options)
            sums.append(output.weight_sum)
    finally:
        library.set_threads(None)
    assert all(torch.equal(sums[0], other) for other in sums[1:])


def test_not_asked_for() -> None:
    output = rasterize(*gaussians(9), *cameras(*SIZE), *SIZE)
    assert output.weight_sum is None


def test_wrong_pixel_weights() -> None:
    scene = (*gaussians(9), *cameras(*SIZE), *SIZE)
    with pytest.raises(EngineError, match=r"\(2, 43, 61\)"):
        rasterize(*scene, with_weight_sum=True, pixel_weights=torch.ones(43, 61))
    with pytest.raises(EngineError, match="with_weight_sum"):
        rasterize(*scene, pixel_weights=pixel_weights())
