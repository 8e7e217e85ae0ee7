"""The image model itself, pinned on scenes whose image can be worked out by hand."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from roigs_engine.formats.targets import BLUR
from roigs_engine.rasterize import RenderOutput, rasterize
from roigs_engine.rasterize.inputs import ALPHA_MAX, ALPHA_MIN, NEAR

SH_C0 = 0.28209479177387814
BACKENDS = ["reference", "cpu"]


def on_the_axis(
    backend: str,
    *,
    depths: list[float],
    opacities: list[float],
    colours: list[list[float]],
    sigma: float = 0.1,
    **options: Tensor | bool | str,
) -> RenderOutput:
    """Balls on the optical axis, seen by a camera with the principal point in pixel (8, 8)."""
    n = len(depths)
    means = torch.zeros(n, 3)
    means[:, 2] = torch.tensor(depths)
    return rasterize(
        means,
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1),
        torch.full((n, 3), sigma),
        torch.tensor(opacities),
        ((torch.tensor(colours) - 0.5) / SH_C0)[:, None],
        torch.eye(4)[None],
        torch.tensor([[[50.0, 0.0, 8.5], [0.0, 40.0, 8.5], [0.0, 0.0, 1.0]]]),
        17,
        17,
        backend=backend,
        **options,
    )


@pytest.mark.parametrize("backend", BACKENDS)
def test_profile_of_a_ball(backend: str) -> None:
    """Pixel (i, j) has its centre at (i + 1/2, j + 1/2); variance is (f sigma / z)^2 + blur."""
    output = on_the_axis(backend, depths=[2.0], opacities=[0.8], colours=[[1.0, 0.25, 0.5]])
    variance_x, variance_y = (50 * 0.1 / 2) ** 2 + BLUR, (40 * 0.1 / 2) ** 2 + BLUR
    alpha = output.alpha[0]
    assert math.isclose(float(alpha[8, 8]), 0.8, rel_tol=1e-5)
    for offset in (-3, 2):
        right = 0.8 * math.exp(-0.5 * offset**2 / variance_x)
        below = 0.8 * math.exp(-0.5 * offset**2 / variance_y)
        assert math.isclose(float(alpha[8, 8 + offset]), right, rel_tol=1e-4)
        assert math.isclose(float(alpha[8 + offset, 8]), below, rel_tol=1e-4)
    expected = 0.8 * torch.tensor([1.0, 0.25, 0.5])
    torch.testing.assert_close(output.image[0, 8, 8], expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("backend", BACKENDS)
def test_blending_is_front_to_back_whatever_the_order_of_the_rows(backend: str) -> None:
    output = on_the_axis(
        backend,
        depths=[3.0, 2.0],
        opacities=[0.5, 0.6],
        colours=[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
        background=torch.tensor([0.0, 0.0, 1.0]),
        with_depth=True,
        with_max_weight=True,
    )
    weights = [0.6, 0.4 * 0.5, 0.4 * 0.5]  # near, far, background
    torch.testing.assert_close(output.image[0, 8, 8], torch.tensor(weights), rtol=1e-5, atol=1e-6)
    assert output.depth is not None and output.max_weight is not None
    mean_depth = (0.6 * 2.0 + 0.2 * 3.0) / 0.8
    assert math.isclose(float(output.depth[0, 8, 8]), mean_depth, rel_tol=1e-5)
    torch.testing.assert_close(output.max_weight, torch.tensor([0.2, 0.6]), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("opacities", "median"),
    [
        ([0.9, 0.99, 0.99], 2.0),  # lets 10 % through
        ([0.3, 0.3, 0.9], 3.0),  # weights 0.3, 0.21, 0.441
        ([0.3, 0.3, 0.99], 3.0),
        ([0.3, 0.1, 0.99], 9.0),
        ([0.2, 0.0, 0.1], 2.0),  # most light comes from behind
        ([0.02, 0.0, 0.1], 9.0),
        ([0.0, 0.0, 0.02], 9.0),
        ([0.0, 0.0, 0.0], 0.0),
    ],
)
def test_median_depth(backend: str, opacities: list[float], median: float) -> None:
    """The depth of the Gaussian where half of the pixel's weights is reached."""
    output = on_the_axis(
        backend,
        depths=[9.0, 2.0, 3.0],
        opacities=[opacities[2], *opacities[:2]],
        colours=[[1.0, 1.0, 1.0]] * 3,
        with_depth="median",
    )
    assert output.depth is not None
    assert float(output.depth[0, 8, 8]) == median


@pytest.mark.parametrize("backend", BACKENDS)
def test_bounds_of_alpha(backend: str) -> None:
    """Opacity is capped, contributions below 1/255 are not drawn, colours are not negative."""
    output = on_the_axis(backend, depths=[2.0], opacities=[1.0], colours=[[-0.5, 0.5, 2.0]])
    assert math.isclose(float(output.alpha[0, 8, 8]), ALPHA_MAX, rel_tol=1e-6)
    drawn = output.alpha[0][output.alpha[0] > 0]
    assert float(drawn.min()) >= ALPHA_MIN * (1 - 1e-5)
    assert float(output.image[..., 0].abs().max()) == 0.0
    assert float(output.image[..., 2].max()) > 1.9

    faint = on_the_axis(backend, depths=[2.0], opacities=[0.0039], colours=[[1.0, 1.0, 1.0]])
    assert not faint.visible.any() and not faint.image.any()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("depth", "seen"), [(NEAR * 1.01, True), (NEAR * 0.99, False), (-2.0, False)]
)
def test_near_plane(backend: str, depth: float, seen: bool) -> None:
    output = on_the_axis(
        backend, depths=[depth], opacities=[0.8], colours=[[1.0, 1.0, 1.0]], sigma=1e-4
    )
    assert bool(output.visible.all()) == seen
    assert bool(output.image.any()) == seen
