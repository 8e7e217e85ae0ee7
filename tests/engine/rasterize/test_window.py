"""A window: images hold a part of the picture, which is the same as when they hold all of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize.tiles import ActiveTiles, active_tiles
from tests.engine.rasterize_cases import BACKGROUND, cameras, gaussians

SIZE = (115, 77)  # 8 by 5 tiles, those at the right and bottom edges are cut
WINDOWS = [(32, 16, 80, 64), (16, 32, 115, 77), (0, 0, *SIZE)]
OPTIONS: dict[str, Any] = {
    "background": BACKGROUND,
    "with_depth": True,
    "with_max_weight": True,
    "with_weight_sum": True,
}


def inside(window: tuple[int, int, int, int], image: Tensor) -> Tensor:
    left, top, right, bottom = window
    return image[:, top:bottom, left:right]


def diagonal(window: tuple[int, int, int, int]) -> Tensor:
    """A mask that leaves some of the window's tiles out, and all that are not in it."""
    left, top, right, bottom = window
    mask = torch.zeros(SIZE[1], SIZE[0], dtype=torch.bool)
    for k in range(min(right - left, bottom - top)):
        mask[top + k, left + k] = True
    return mask


def within(window: tuple[int, int, int, int]) -> ActiveTiles:
    """The same mask, with the window."""
    return replace(active_tiles(*SIZE, diagonal(window)), window=window)


def rendered(
    window: tuple[int, int, int, int], parameters: list[Tensor], *, cut: bool, **options: Any
) -> Any:
    """The mask's tiles, as images of the window, or of all with the same tiles."""
    scene = (*parameters, *cameras(*SIZE), *SIZE)
    mask = within(window) if cut else diagonal(window)
    return rasterize(*scene, mask=mask, **OPTIONS, **options)


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("depth", [True, "median"])
def test_holds_what_the_whole_picture_has_there(
    isa: str, window: tuple[int, int, int, int], depth: Any
) -> None:
    parameters, options = gaussians(300, coefficients=4), {**OPTIONS, "with_depth": depth}
    scene = (*parameters, *cameras(*SIZE), *SIZE)
    counted = torch.rand(2, SIZE[1], SIZE[0], generator=torch.Generator().manual_seed(1))
    options["pixel_weights"] = counted
    whole = rasterize(*scene, mask=diagonal(window), **options)
    part = rasterize(*scene, mask=within(window), **options)
    assert int(whole.visible.sum()) > 20
    for name in ("image", "alpha", "depth"):
        assert torch.equal(getattr(part, name), inside(window, getattr(whole, name))), name
    for name in ("visible", "max_weight", "weight_sum"):
        assert torch.equal(getattr(part, name), getattr(whole, name)), name


@pytest.mark.parametrize("window", WINDOWS)
def test_gradients_are_those_of_the_whole_picture(
    isa: str, window: tuple[int, int, int, int]
) -> None:
    found = []
    for cut in (True, False):
        parameters = [p.requires_grad_() for p in gaussians(200, coefficients=4)]
        output = rendered(window, parameters, cut=cut)
        image = output.image if cut else inside(window, output.image)
        image.square().sum().backward()
        found.append([*(p.grad for p in parameters), output.grad2d])
    for part, whole in zip(*found, strict=True):
        assert whole.abs().sum() > 0
        assert torch.equal(part, whole)


def test_all_backends_hold_the_same_part() -> None:
    parameters = gaussians(100, coefficients=1)
    window = WINDOWS[0]
    ours = rendered(window, parameters, cut=True, backend="cpu")
    truth = rendered(window, parameters, cut=True, backend="reference")
    for name in ("image", "alpha", "depth"):
        assert getattr(ours, name).shape == getattr(truth, name).shape
    torch.testing.assert_close(ours.image, truth.image, rtol=0, atol=5e-3)


def test_a_window_of_everything_cuts_nothing() -> None:
    output = rasterize(*gaussians(5), *cameras(*SIZE), *SIZE, backend="reference")
    assert output.cut((0, 0, *SIZE)) is output


def test_no_tile_of_the_window_is_active() -> None:
    scene = (*gaussians(50, coefficients=1), *cameras(*SIZE), *SIZE)
    nothing = ActiveTiles(size=SIZE, rectangle=(0, 0, 0, 0), window=WINDOWS[0])
    image = rasterize(*scene, mask=nothing, background=BACKGROUND).image
    assert torch.equal(image, BACKGROUND.expand(2, 48, 48, 3))


@pytest.mark.parametrize(
    "window",
    [(32, 16, 80, 63), (31, 16, 80, 64), (16, 16, 16, 64), (0, 0, 0, 0), (0, 0, 128, 80)],
)
def test_windows_that_are_not_made_of_whole_tiles(window: tuple[int, int, int, int]) -> None:
    tiles = ActiveTiles(size=SIZE, rectangle=(2, 1, 3, 2), window=window)
    with pytest.raises(EngineError, match="whole tiles"):
        rasterize(*gaussians(5), *cameras(*SIZE), *SIZE, mask=tiles)


@pytest.mark.parametrize("rectangle", [(2, 1, 6, 4), (0, 0, 8, 5)])
def test_tiles_outside_of_the_window(rectangle: tuple[int, int, int, int]) -> None:
    tiles = ActiveTiles(size=SIZE, rectangle=rectangle, window=(32, 16, 80, 64))
    with pytest.raises(EngineError, match="beyond the window"):
        rasterize(*gaussians(5), *cameras(*SIZE), *SIZE, mask=tiles)


def test_the_window_of_the_tiles_themselves() -> None:
    tiles = active_tiles(*SIZE, (100, 70, 115, 77))
    assert tiles.shown == (0, 0, *SIZE)
    assert tiles.windowed().shown == (96, 64, *SIZE)
