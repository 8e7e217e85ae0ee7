"""L1 + SSIM: the kernel against float64 autograd of the plain form, and the plain form by hand."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.kernels import library
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.photos.exposures import levelled
from roigs_engine.training.losses import LossOutput, clipped_like
from tests.engine.training.reference_loss import photo_loss, ssim_map

SIZES = [(1, 1), (2, 3), (5, 40), (16, 16), (33, 17), (61, 90)]  # (H, W)


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    before = library.threads()
    yield
    library.set_threads(before)


def picture(height: int, width: int, *, noise: float, seed: int = 0) -> tuple[Tensor, Tensor]:
    """A planar render (3, H, W) and a photo (H, W, 3) like it: flat areas, where SSIM is stiff."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 3, height // 20 + 2, width // 20 + 2, generator=generator)
    base = torch.nn.functional.interpolate(coarse, (height, width), mode="bilinear")[0]
    photo = (base + 0.01 * torch.randn(base.shape, generator=generator)).clamp(0, 1)
    render = (base + noise * torch.randn(base.shape, generator=generator)).clamp(0, 1)
    return render, (photo * 255).round().to(torch.uint8).permute(1, 2, 0).contiguous()


def loss_and_gradient(
    planar: Tensor, photo: Tensor, weights: Tensor | None = None, backend: str = "cpu"
) -> tuple[LossOutput, Tensor]:
    image = planar.clone().requires_grad_()
    output = photo_loss(image.permute(1, 2, 0), photo, weights=weights, backend=backend)
    output.loss.backward()
    assert image.grad is not None
    return output, image.grad


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("noise", [0.01, 0.3])
@pytest.mark.parametrize("weighted", [False, True])
def test_kernel_is_the_float64_reference(
    size: tuple[int, int], noise: float, weighted: bool
) -> None:
    planar, photo = picture(*size, noise=noise)
    weights = torch.rand(size, generator=torch.Generator().manual_seed(1)) if weighted else None
    ours, gradient = loss_and_gradient(planar, photo, weights)
    exact, wanted = loss_and_gradient(planar.double(), photo, weights, backend="reference")
    for mine, true in zip(ours, exact, strict=True):
        assert mine.item() == pytest.approx(true.item(), abs=3e-6)
    assert (gradient - wanted).norm() <= 1e-4 * wanted.norm()


def test_ssim_by_hand() -> None:
    """One pixel at a corner, from the definition: an 11 x 11 window over zero-padded images."""
    generator = torch.Generator().manual_seed(2)
    image, target = torch.rand(2, 9, 8, 3, dtype=torch.float64, generator=generator)
    y, x, channel = 1, 7, 2
    total = mean_x = mean_t = xx = tt = xt = 0.0
    for dy in range(-5, 6):
        for dx in range(-5, 6):
            weight = math.exp(-(dy * dy + dx * dx) / (2 * 1.5**2))
            total += weight
            if 0 <= y + dy < 9 and 0 <= x + dx < 8:
                a = image[y + dy, x + dx, channel].item()
                b = target[y + dy, x + dx, channel].item()
                mean_x, mean_t = mean_x + weight * a, mean_t + weight * b
                xx, tt, xt = xx + weight * a * a, tt + weight * b * b, xt + weight * a * b
    mean_x, mean_t, xx, tt, xt = (v / total for v in (mean_x, mean_t, xx, tt, xt))
    c1, c2 = 0.01**2, 0.03**2
    wanted = (2 * mean_x * mean_t + c1) * (2 * (xt - mean_x * mean_t) + c2)
    wanted /= (mean_x**2 + mean_t**2 + c1) * (xx - mean_x**2 + tt - mean_t**2 + c2)
    assert ssim_map(image, target)[y, x, channel].item() == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_parts_make_the_loss(backend: str) -> None:
    planar, photo = picture(20, 30, noise=0.1)
    image = planar.permute(1, 2, 0)
    loss, l1, ssim = photo_loss(image, photo, ssim_weight=0.3, backend=backend)
    assert l1.item() == pytest.approx((image - photo / 255).abs().mean().item(), rel=1e-5)
    assert ssim.item() == pytest.approx(ssim_map(image, photo).mean().item(), rel=1e-5)
    assert loss.item() == pytest.approx(0.7 * l1.item() + 0.3 * (1 - ssim.item()), rel=1e-5)


@pytest.mark.parametrize("threads", [2, 3, 8])
def test_same_bits_at_any_thread_count(threads: int) -> None:
    planar, photo = picture(203, 77, noise=0.1)
    weights = torch.rand(203, 77, generator=torch.Generator().manual_seed(3))
    library.set_threads(1)
    loss, gradient = loss_and_gradient(planar, photo, weights)
    library.set_threads(threads)
    again, same = loss_and_gradient(planar, photo, weights)
    assert [v.item() for v in again] == [v.item() for v in loss]
    assert torch.equal(same, gradient)


def test_scratch_is_clean_when_sizes_alternate() -> None:
    first, second = picture(40, 70, noise=0.2), picture(40, 21, noise=0.2)
    wanted = [loss_and_gradient(*p)[1] for p in (first, second)]
    again = [loss_and_gradient(*p)[1] for p in (second, first)]
    assert torch.equal(again[1], wanted[0])
    assert torch.equal(again[0], wanted[1])


def test_image_layouts() -> None:
    """Planar memory with and without a leading 1, and interleaved memory: one gradient."""
    planar, photo = picture(13, 19, noise=0.1)
    _, wanted = loss_and_gradient(planar, photo)
    for image in (
        planar.permute(1, 2, 0)[None].detach().clone(memory_format=torch.preserve_format),
        planar.permute(1, 2, 0).contiguous(),
    ):
        image.requires_grad_()
        photo_loss(image, photo).loss.backward()
        assert image.grad is not None
        assert torch.equal(image.grad.reshape(13, 19, 3), wanted.permute(1, 2, 0))


def test_gradient_arrives_planar() -> None:
    planar, photo = picture(13, 19, noise=0.1)
    arrived: list[Tensor] = []
    image = planar.requires_grad_()
    view = image.permute(1, 2, 0)
    view.register_hook(arrived.append)  # type: ignore[no-untyped-call]
    (3.0 * photo_loss(view, photo).loss).backward()
    assert arrived[0].permute(2, 0, 1).is_contiguous()
    unscaled = loss_and_gradient(planar.detach(), photo)[1]
    assert torch.allclose(arrived[0].permute(2, 0, 1), 3 * unscaled)


def test_equal_images_have_no_loss() -> None:
    _, photo = picture(24, 31, noise=0.1)
    output, gradient = loss_and_gradient((photo / 255).permute(2, 0, 1), photo)
    assert output.l1.item() == 0.0
    assert output.ssim.item() == pytest.approx(1.0, abs=1e-6)
    assert gradient.abs().max().item() < 1e-6


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_weights(backend: str) -> None:
    planar, photo = picture(24, 31, noise=0.1)
    plain, gradient = loss_and_gradient(planar, photo, backend=backend)
    equal, same = loss_and_gradient(planar, photo, torch.full((24, 31), 7.0), backend=backend)
    assert equal.loss.item() == pytest.approx(plain.loss.item(), rel=1e-5)
    assert torch.allclose(same, gradient, atol=1e-8)

    none, zero = loss_and_gradient(planar, photo, torch.zeros(24, 31), backend=backend)
    assert none.loss.item() == 0.0
    assert not zero.any()

    # Pixels without weight count nowhere, but the window of their neighbours reaches them.
    mask = torch.zeros(24, 31)
    mask[10:14, 10:14] = 1
    part, local = loss_and_gradient(planar, photo, mask, backend=backend)
    inside = (planar.permute(1, 2, 0) - photo / 255)[10:14, 10:14].abs().mean()
    assert part.l1.item() == pytest.approx(inside.item(), rel=1e-5)
    assert local[:, 5:19, 5:19].abs().sum() > 0
    local[:, 5:19, 5:19] = 0
    assert not local.any()


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_broken_pixel_is_seen(value: float) -> None:
    planar, photo = picture(24, 31, noise=0.1)
    planar[1, 12, 30] = value
    assert not loss_and_gradient(planar, photo)[0].loss.isfinite()


def test_a_model_may_be_brighter_than_the_white_of_a_brighter_photo() -> None:
    _, pixels = picture(8, 9, noise=0.1)
    stops, pixels[:4] = 1.0, 255
    photo = torch.from_numpy(levelled(pixels.numpy(), stops))
    camera = Camera(width=9, height=8, fx=9, fy=9, cx=4.5, cy=4)
    taken = PosedImage(name="a.jpg", path=Path("a.jpg"), camera=camera, world_to_camera=np.eye(4))
    brighter = replace(taken, exposure=stops)
    same = photo.float() / 255
    for change, pulled in ((0.3, False), (-0.3, True)):
        image = (same + change * (torch.arange(8) < 4)[:, None, None]).requires_grad_()
        photo_loss(clipped_like(image, brighter), photo, backend="cpu").loss.backward()
        assert image.grad is not None and bool(image.grad[:3].abs().max() > 1e-5) == pulled
    assert clipped_like(same, taken) is same


def test_without_gradient() -> None:
    planar, photo = picture(24, 31, noise=0.1)
    wanted = loss_and_gradient(planar, photo)[0].loss.item()
    output = photo_loss(planar.permute(1, 2, 0), photo)
    assert not output.loss.requires_grad
    assert output.loss.item() == wanted


def test_errors() -> None:
    image, photo = torch.rand(4, 5, 3), torch.zeros(4, 5, 3, dtype=torch.uint8)
    for arguments, text in (
        ((image[..., :2], photo), "image is"),
        ((image, photo[:3]), "target is"),
        ((image, photo.float()), "target is"),
        ((image[:0], photo[:0]), "image is"),
    ):
        with pytest.raises(EngineError, match=text):
            photo_loss(*arguments)
    with pytest.raises(EngineError, match="weights are"):
        photo_loss(image, photo, weights=torch.ones(5, 4))
    with pytest.raises(EngineError, match="backend"):
        photo_loss(image, photo, backend="gpu")
    with pytest.raises(EngineError, match="float32"):
        photo_loss(image.double(), photo, backend="cpu")
