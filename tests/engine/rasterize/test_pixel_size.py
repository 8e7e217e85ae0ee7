"""`pixel_size`: small pictures are drawn as the averages of large ones, large ones as blurred."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.rasterize import rasterize
from tests.engine.rasterize_cases import (
    assert_matches,
    cameras,
    dots_to_needles,
    gaussians,
    largest_difference,
    relative_error,
    render_both,
)

SIDE = 48  # px of the whole picture
BACKENDS = ["reference", "cpu"]


def draw(parameters: list[Tensor], factor: int, backend: str, **options: Any) -> Tensor:
    """(H, W, 3) the picture, `factor` times smaller."""
    side = SIDE // factor
    focal = 40.0 / factor
    pinhole = torch.tensor([[[focal, 0.0, side / 2], [0.0, focal, side / 2], [0.0, 0.0, 1.0]]])
    view = torch.eye(4)[None]
    drawn = rasterize(*parameters, view, pinhole, side, side, backend=backend, **options)
    return drawn.image[0].detach().double()


def averaged(picture: Tensor, factor: int) -> Tensor:
    """The means of its squares of `factor` x `factor` pixels."""
    side = len(picture) // factor
    return picture.reshape(side, factor, side, factor, 3).mean((1, 3))


def ellipsoid(size: float) -> list[Tensor]:
    """One at depth 4, `size` px wide in the whole picture, three times as long, turned."""
    quats = torch.tensor([[math.cos(0.3), 0.0, 0.0, math.sin(0.3)]])
    scales = torch.tensor([[3 * size, size, size]]) * 4 / 40.0
    colour = torch.full((1, 1, 3), 0.5 / 0.28209479)  # white
    return [torch.tensor([[0.13, -0.07, 4.0]]), quats, scales, torch.tensor([0.8]), colour]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("factor", [2, 3])
@pytest.mark.parametrize("size", [0.01, 0.2, 0.5, 1.0, 4.0])
def test_a_gaussian_is_drawn_as_its_average(backend: str, factor: int, size: float) -> None:
    whole = averaged(draw(ellipsoid(size), 1, backend), factor)
    small = draw(ellipsoid(size), factor, backend, pixel_size=float(factor))
    wide = draw(ellipsoid(size), factor, backend)
    # What is fainter than 1/255 is never drawn: a dot loses its rim in the whole picture.
    assert float(small.sum()) == pytest.approx(float(whole.sum()), rel=0.2 if size < 0.5 else 0.02)
    assert relative_error(small, whole) < (0.15 if size < 0.5 else 0.03)
    assert relative_error(wide, whole) > 10 * relative_error(small, whole)


def test_a_scene_is_drawn_nearly_as_its_average() -> None:
    """Not exactly: what lies behind something shows through an average more or less."""
    parameters = gaussians(1500, size=0.02)
    whole = averaged(draw(parameters, 1, "cpu"), 2)
    small = draw(parameters, 2, "cpu", pixel_size=2.0)
    assert relative_error(small, whole) < 0.5 * relative_error(draw(parameters, 2, "cpu"), whole)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("size", [0.2, 1.0, 4.0])
def test_the_average_of_a_larger_picture_is_the_photo(backend: str, size: float) -> None:
    parameters = ellipsoid(size)
    whole = draw(parameters, 2, backend)  # the photo is the small one
    large = averaged(draw(parameters, 1, backend, pixel_size=0.5), 2)
    sharp = averaged(draw(parameters, 1, backend), 2)
    assert relative_error(large, whole) < (0.15 if size < 0.5 else 0.03)
    assert relative_error(sharp, whole) > 3 * relative_error(large, whole)


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("pixel_size", [0.3, 1.4, 2.0])
def test_everything_matches(isa: str, raw: bool, pixel_size: float) -> None:
    assert_matches(raw=raw, pixel_size=pixel_size)


def test_shapes_from_dots_to_needles(isa: str) -> None:
    ours, truth, _ = render_both(dots_to_needles(300), *cameras(61, 43), 61, 43, pixel_size=2.0)
    assert torch.equal(ours.visible, truth.visible)
    assert largest_difference(ours.image, truth.image) < 1e-3


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("pixel_size", [0.0, -1.0, math.nan, math.inf])
def test_a_pixel_has_a_size(backend: str, pixel_size: float) -> None:
    with pytest.raises(EngineError, match="pixel_size"):
        draw(ellipsoid(1.0), 1, backend, pixel_size=pixel_size)
