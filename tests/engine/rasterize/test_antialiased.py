"""`antialiased`: a Gaussian below a pixel's size is fainter, not larger."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from roigs_engine.formats.targets import BLUR, CYCLES
from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize.light import to_linear, to_srgb
from roigs_engine.rasterize.view import rasterize_view
from tests.engine.clouds import CAMERA, POSE, cloud
from tests.engine.rasterize_cases import (
    assert_matches,
    cameras,
    dots_to_needles,
    gaussians,
    largest_difference,
    render_both,
)

SIDE = 64  # px of the largest picture
BACKENDS = ["reference", "cpu"]


def light(size: float, backend: str, *, side: int = SIDE, **options: Any) -> float:
    """All light of one white Gaussian of opacity 0.5, in units of the largest picture's pixels.

    It is `size` px wide in the largest picture, twice as long, and tilted.
    """
    focal = 50.0 * side / SIDE
    pinhole = torch.tensor([[[focal, 0.0, side / 2], [0.0, focal, side / 2], [0.0, 0.0, 1.0]]])
    quats = torch.tensor([[math.cos(0.3), 0.0, 0.0, math.sin(0.3)]])
    scales = torch.tensor([[2 * size, size, size]]) * 4 / 50.0
    colour = torch.full((1, 1, 3), 0.5 / 0.28209479)
    place = torch.tensor([[0.03, -0.02, 4.0]])
    parameters = (place, quats, scales, torch.tensor([0.5]), colour)
    view = torch.eye(4)[None]
    image = rasterize(*parameters, view, pinhole, side, side, backend=backend, **options).image
    return float(image[0, ..., 0].double().sum()) * (SIDE / side) ** 2


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("size", [1.0, 2.0])
@pytest.mark.parametrize("factor", [2, 4])
def test_it_has_the_same_light_in_small_pictures(backend: str, size: float, factor: int) -> None:
    whole = light(size, backend, antialiased=True)
    small = light(size, backend, side=SIDE // factor, antialiased=True)
    plain = light(size, backend, side=SIDE // factor)
    assert whole == pytest.approx(math.pi * 2 * size**2, rel=0.05)  # opacity x 2 pi x its axes
    assert small == pytest.approx(whole, rel=0.05)
    assert plain > 1.1 * whole


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_large_gaussian_is_drawn_as_without(backend: str) -> None:
    plain, ours = (light(6.0, backend, antialiased=on) for on in (False, True))
    # its light is lower by the root of the ratio of the determinants
    ratio = 12**2 * 6**2 / ((12**2 + BLUR) * (6**2 + BLUR))
    assert ours / plain == pytest.approx(math.sqrt(ratio), rel=1e-3)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_speck_is_not_drawn(backend: str) -> None:
    assert light(0.01, backend) > 0.1
    assert light(0.01, backend, antialiased=True) == 0


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("pixel_size", [1.0, 2.0])
def test_everything_matches(isa: str, raw: bool, pixel_size: float) -> None:
    assert_matches(raw=raw, antialiased=True, pixel_size=pixel_size)


def test_shapes_from_dots_to_needles(isa: str) -> None:
    ours, truth, errors = render_both(
        dots_to_needles(300), *cameras(61, 43), 61, 43, antialiased=True
    )
    assert 0 < ours.visible.any(0).sum() < 300
    assert torch.equal(ours.visible, truth.visible)
    assert largest_difference(ours.image, truth.image) < 1e-3
    assert all(math.isfinite(error) for error in errors.values())


def test_gradients_are_finite_and_right_for_flat_gaussians_from_their_edge(isa: str) -> None:
    """Their area is all but zero: the derivative of its root would be infinite."""
    parameters: list[Tensor] = gaussians(80, raw=True, size=0.05, seed=2)
    with torch.no_grad():
        parameters[2][:, 0] = -40.0
    ours, truth, errors = render_both(
        parameters, *cameras(61, 43), 61, 43, raw=True, antialiased=True
    )
    assert torch.equal(ours.visible, truth.visible)
    assert max(errors.values()) < 1e-3, errors


def test_cycles_is_drawn_as_averages_over_square_pixels() -> None:
    random, fine = np.random.default_rng(1), CAMERA.resized(8 * CAMERA.width, 8 * CAMERA.height)
    sizes = random.uniform(math.log(0.01), math.log(0.1), (800, 3))
    places = random.normal(scale=0.6, size=(800, 3))
    model = replace(cloud(800, means=places, log_scales=sizes), target=CYCLES)
    light = to_linear(rasterize_view(model, fine, POSE).image[0]).permute(2, 0, 1)
    wanted = to_srgb(torch.nn.functional.avg_pool2d(light, 8)).permute(1, 2, 0)
    errors = [
        float((rasterize_view(each, CAMERA, POSE).image[0] - wanted).square().mean())
        for each in (model, replace(model, target=replace(CYCLES, blur=BLUR)))
    ]
    assert 3 * errors[0] < errors[1]
