"""A mask as the region: the tiles that it touches, and only these, are worked on."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize.inputs import TILE
from roigs_engine.rasterize.tiles import ActiveTiles, active_tiles
from tests.engine.rasterize_cases import (
    BACKGROUND,
    cameras,
    gaussians,
    largest_difference,
    render_both,
)

SIZE = (115, 77)  # 8 by 5 tiles, those at the right and bottom edges are cut


def ring() -> Tensor:
    """One pixel wide, around the middle of the image."""
    mask = torch.zeros(SIZE[1], SIZE[0], dtype=torch.bool)
    mask[20, 20:110] = mask[76, 20:110] = mask[20:77, 20] = mask[20:77, 109] = True
    return mask


def scattered() -> Tensor:
    return torch.rand(SIZE[1], SIZE[0], generator=torch.Generator().manual_seed(2)) < 0.002


def touched(mask: Tensor) -> Tensor:
    """(H, W) bool: pixels of the tiles that a mask touches."""
    pixels = torch.zeros_like(mask)
    for y, x in (mask.nonzero() // TILE * TILE).tolist():
        pixels[y : y + TILE, x : x + TILE] = True
    return pixels


@pytest.mark.parametrize("mask", [ring(), scattered()], ids=["ring", "scattered"])
def test_matches_the_reference(isa: str, mask: Tensor) -> None:
    ours, truth, errors = render_both(
        gaussians(300, coefficients=4, seed=1),
        *cameras(*SIZE),
        *SIZE,
        mask=mask,
        background=BACKGROUND,
        with_depth=True,
        with_max_weight=True,
        with_weight_sum=True,
    )
    assert 0 < int(truth.visible.sum()) < 600
    assert torch.equal(ours.visible, truth.visible)
    for name in ("image", "alpha", "depth", "max_weight", "weight_sum"):
        assert largest_difference(getattr(ours, name), getattr(truth, name)) < 1e-3, name
    assert max(errors.values()) < 1e-4, errors


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_inside_is_as_without_and_outside_is_background(backend: str) -> None:
    inside = touched(ring())
    assert 0.3 < float(inside.float().mean()) < 0.7
    scene = (*gaussians(300, coefficients=4), *cameras(*SIZE), *SIZE)
    options = {"background": BACKGROUND, "with_depth": True, "backend": backend}
    whole = rasterize(*scene, **options)
    part = rasterize(*scene, mask=ring(), **options)
    assert whole.depth is not None and part.depth is not None
    torch.testing.assert_close(part.image[:, inside], whole.image[:, inside], rtol=0, atol=1e-6)
    torch.testing.assert_close(part.depth[:, inside], whole.depth[:, inside], rtol=0, atol=1e-5)
    assert torch.equal(part.image[:, ~inside], BACKGROUND.expand(part.image[:, ~inside].shape))
    assert not part.alpha[:, ~inside].any() and not part.depth[:, ~inside].any()


def test_tiles_that_were_found_before_are_as_good_as_the_mask() -> None:
    scene = (*gaussians(300, coefficients=4), *cameras(*SIZE), *SIZE)
    tiles = active_tiles(*SIZE, ring())
    assert torch.equal(rasterize(*scene, mask=tiles).image, rasterize(*scene, mask=ring()).image)
    with pytest.raises(EngineError, match="tiles of an image"):
        rasterize(*scene[:-2], SIZE[0] - 1, SIZE[1], mask=tiles)


@pytest.mark.parametrize(
    ("rectangle", "mask"),
    [
        ((0, 0, 8, 5), torch.ones(1, 1, dtype=torch.bool)),
        ((0, 0, 8, 5), torch.ones(5, 8)),
        ((0, 0, 9, 5), None),
        ((-1, 0, 8, 5), None),
        ((3, 0, 2, 5), None),
    ],
)
def test_tiles_that_do_not_fit_the_image(
    rectangle: tuple[int, int, int, int], mask: Tensor | None
) -> None:
    tiles = ActiveTiles(size=SIZE, rectangle=rectangle, mask=mask)
    with pytest.raises(EngineError, match="do not fit"):
        rasterize(*gaussians(5), *cameras(*SIZE), *SIZE, mask=tiles)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_gradient_is_that_of_the_pixels_inside(backend: str) -> None:
    inside = touched(ring())
    gradients = []
    for region in (ring(), None):
        parameters = [p.requires_grad_() for p in gaussians(200, coefficients=1)]
        image = rasterize(*parameters, *cameras(*SIZE), *SIZE, mask=region, backend=backend).image
        (image.square() * inside[..., None]).sum().backward()
        gradients.append([p.grad for p in parameters])
    for masked, whole in zip(*gradients, strict=True):
        torch.testing.assert_close(masked, whole, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_full_and_empty_masks(backend: str) -> None:
    scene = (*gaussians(100, coefficients=1), *cameras(*SIZE), *SIZE)
    full = torch.ones(SIZE[1], SIZE[0], dtype=torch.bool)
    whole = rasterize(*scene, backend=backend)
    assert torch.equal(rasterize(*scene, mask=full, backend=backend).image, whole.image)
    nothing = rasterize(*scene, mask=~full, background=BACKGROUND, backend=backend)
    assert torch.equal(nothing.image, BACKGROUND.expand(nothing.image.shape))
    assert not nothing.visible.any()


def test_second_backward_through_one_graph() -> None:
    parameters = [p.requires_grad_() for p in gaussians(100, coefficients=1)]
    loss = rasterize(*parameters, *cameras(*SIZE), *SIZE, mask=ring()).image.square().sum()
    loss.backward(retain_graph=True)
    once = [p.grad.clone() for p in parameters if p.grad is not None]
    rasterize(*parameters, *cameras(*SIZE), *SIZE)  # takes over the memory of the first rendering
    for p in parameters:
        p.grad = None
    loss.backward()
    for p, gradient in zip(parameters, once, strict=True):
        assert torch.equal(p.grad, gradient)


@pytest.mark.parametrize("mask", [torch.ones(SIZE, dtype=torch.bool), torch.ones(SIZE[::-1])])
def test_wrong_masks(mask: Tensor) -> None:
    with pytest.raises(EngineError, match="mask is"):
        rasterize(*gaussians(9), *cameras(*SIZE), *SIZE, mask=mask)
