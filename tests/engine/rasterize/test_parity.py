"""The compiled rasterizer gives the reference's image and float64 autograd's gradients."""

from __future__ import annotations

import pytest
import torch

from roigs_engine.model.gaussians import SH_C0
from roigs_engine.rasterize import rasterize
from tests.engine.rasterize_cases import (
    BACKGROUND,
    cameras,
    differentiate,
    dots_to_needles,
    gaussians,
    gradient_errors,
    largest_difference,
    relative_error,
    render_both,
)

GRADIENT_TOLERANCE = 1e-4  # relative L2 per parameter
IMAGE_TOLERANCE = 1e-3


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_everything_matches(isa: str, raw: bool, coefficients: int) -> None:
    parameters = gaussians(150, coefficients=coefficients, raw=raw)
    ours, truth, errors = render_both(
        parameters,
        *cameras(61, 43),
        61,
        43,
        raw=raw,
        background=BACKGROUND,
        with_depth=True,
        with_max_weight=True,
    )
    assert int(truth.visible.sum()) > 120
    assert torch.equal(ours.visible, truth.visible)
    assert largest_difference(ours.image, truth.image) < IMAGE_TOLERANCE
    assert largest_difference(ours.alpha, truth.alpha) < IMAGE_TOLERANCE
    assert largest_difference(ours.depth, truth.depth) < IMAGE_TOLERANCE
    assert largest_difference(ours.max_weight, truth.max_weight) < IMAGE_TOLERANCE
    assert relative_error(ours.grad2d, truth.grad2d) < GRADIENT_TOLERANCE
    assert max(errors.values()) < GRADIENT_TOLERANCE, errors


def test_linear_light(isa: str) -> None:
    """Colours are blended as light, black ones and those above 1, too."""
    parameters = gaussians(150, coefficients=4)
    with torch.no_grad():
        parameters[4][::7, 0] = -5.0
        parameters[4][::5, 0] += 3.0
    view = (*cameras(61, 43), 61, 43)
    ours, truth, errors = render_both(parameters, *view, linear_light=True, background=BACKGROUND)
    assert largest_difference(ours.image, truth.image) < IMAGE_TOLERANCE
    assert relative_error(ours.grad2d, truth.grad2d) < GRADIENT_TOLERANCE
    assert max(errors.values()) < GRADIENT_TOLERANCE, errors


def test_one_colour_is_the_same_in_either_light(isa: str) -> None:
    colour = torch.tensor([0.02, 0.4, 0.9])
    means, quats, scales, opacities, _ = gaussians(150, coefficients=1)
    sh = ((colour - 0.5) / SH_C0).expand(150, 1, 3)
    scene = (means, quats, scales, opacities, sh, *cameras(61, 43), 61, 43)
    sums = [rasterize(*scene, linear_light=linear, background=colour) for linear in (False, True)]
    for output in sums:
        assert largest_difference(output.image, colour.expand_as(output.image)) < 1e-5
    mixed = [rasterize(*scene, linear_light=linear).image for linear in (False, True)]
    assert (mixed[1] >= mixed[0] - 1e-5).all()  # light over black is brighter than its sRGB value
    assert mixed[1].mean() > 1.1 * mixed[0].mean()


@pytest.mark.parametrize("size", [(1, 1), (3, 40), (16, 16), (17, 5), (64, 33)])
def test_image_sizes(isa: str, size: tuple[int, int]) -> None:
    parameters = gaussians(150, coefficients=4)
    ours, truth, errors = render_both(parameters, *cameras(*size), *size, with_max_weight=True)
    assert torch.equal(ours.visible, truth.visible)
    assert largest_difference(ours.image, truth.image) < IMAGE_TOLERANCE
    assert largest_difference(ours.max_weight, truth.max_weight) < IMAGE_TOLERANCE
    assert max(errors.values()) < GRADIENT_TOLERANCE, errors


def test_many_opaque_layers(isa: str) -> None:
    """Where blocks end early, what is dropped stays below the tolerance."""
    parameters = gaussians(1200, coefficients=1, size=0.5)
    ours, truth, errors = render_both(parameters, *cameras(24, 24), 24, 24)
    assert float((truth.alpha > 1 - 1e-6).double().mean()) > 0.5
    assert largest_difference(ours.image, truth.image) < 1e-5
    assert max(errors.values()) < GRADIENT_TOLERANCE, errors


def test_shapes_from_dots_to_needles(isa: str) -> None:
    scene = (dots_to_needles(300), *cameras(61, 43), 61, 43)
    ours, truth, errors = render_both(*scene)
    assert torch.equal(ours.visible, truth.visible)
    assert largest_difference(ours.image, truth.image) < IMAGE_TOLERANCE
    # What float32 can give here is less than elsewhere; the kernels are not to fall behind it.
    _, single = differentiate("reference", torch.float32, *scene)
    _, double = differentiate("reference", torch.float64, *scene)
    limits = gradient_errors(single, double)
    for name, error in errors.items():
        assert error < limits[name] + GRADIENT_TOLERANCE, (name, errors, limits)


@pytest.mark.parametrize(("count", "size"), [(150, 0.05), (150, 0.13), (500, 0.13), (150, 0.5)])
@pytest.mark.parametrize("mask", [None, (10, 3, 40, 30)])
def test_median_depth(
    isa: str, count: int, size: float, mask: tuple[int, int, int, int] | None
) -> None:
    """Next to it, nothing changes."""
    parameters = gaussians(count, coefficients=1, size=size)
    scene = (*cameras(61, 43), 61, 43)
    ours, truth, errors = render_both(parameters, *scene, mask=mask, with_depth="median")
    assert ours.depth is not None and truth.depth is not None
    other = (ours.depth - truth.depth).abs() > IMAGE_TOLERANCE
    assert float(other.double().mean()) < 1e-3  # rounding may pick the Gaussian next to it
    assert torch.equal(ours.depth > 0, ours.alpha > 0)
    assert max(errors.values()) < GRADIENT_TOLERANCE, errors
    plain = rasterize(*parameters, *scene, mask=mask)
    assert torch.equal(ours.image, plain.image) and torch.equal(ours.alpha, plain.alpha)


@pytest.mark.parametrize("region", [(10, 3, 40, 30), (0, 0, 1, 1), (-50, 20, 500, 21)])
def test_region(region: tuple[int, int, int, int]) -> None:
    """Tiles that touch the region are drawn in full; the rest is background without gradient."""
    parameters = gaussians(250, coefficients=4)
    ours, truth, errors = render_both(
        parameters,
        *cameras(61, 43),
        61,
        43,
        mask=region,
        background=BACKGROUND,
        with_depth=True,
        with_max_weight=True,
    )
    assert torch.equal(ours.visible, truth.visible)
    assert largest_difference(ours.image, truth.image) < IMAGE_TOLERANCE
    assert largest_difference(ours.depth, truth.depth) < IMAGE_TOLERANCE
    assert largest_difference(ours.max_weight, truth.max_weight) < IMAGE_TOLERANCE
    assert max(errors.values()) < GRADIENT_TOLERANCE, errors
    assert torch.equal(ours.image[0, 35, 50], BACKGROUND)


@pytest.mark.parametrize("region", [(70, 0, 90, 20), (5, 5, 5, 9), (-9, -9, 0, 0)])
def test_region_off_the_image(region: tuple[int, int, int, int]) -> None:
    parameters = gaussians(50, coefficients=1)
    ours, truth, _ = render_both(
        parameters, *cameras(61, 43), 61, 43, mask=region, background=BACKGROUND
    )
    assert torch.equal(ours.image, BACKGROUND.expand(ours.image.shape))
    assert torch.equal(ours.image, truth.image.float())
    assert not ours.visible.any() and not truth.visible.any()


def test_lower_degree_ignores_the_other_bands() -> None:
    parameters = gaussians(250)
    fewer = [*parameters[:4], parameters[4][:, :4].clone()]
    views, intrinsics = cameras(61, 43)
    ours, _, errors = render_both(parameters, views, intrinsics, 61, 43, sh_degree=1)
    same, _, _ = render_both(fewer, views, intrinsics, 61, 43)
    assert torch.equal(ours.image, same.image)
    assert max(errors.values()) < GRADIENT_TOLERANCE, errors


@pytest.mark.parametrize("raw", [False, True])
def test_nan_is_not_drawn(isa: str, raw: bool) -> None:
    sound = gaussians(100, raw=raw)
    broken = [p.clone() for p in sound]
    for row, p in enumerate(broken):
        p[row].view(-1)[0] = float("nan")
    rest = [p[len(broken) :] for p in sound]
    ours, truth, _ = render_both(broken, *cameras(40, 40), 40, 40, raw=raw)
    assert not ours.visible[:, : len(broken)].any()
    assert torch.equal(ours.visible, truth.visible)
    alone, _, _ = render_both(rest, *cameras(40, 40), 40, 40, raw=raw)
    assert torch.equal(ours.image, alone.image)
