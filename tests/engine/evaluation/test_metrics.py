"""PSNR and SSIM over masks: known values, equal images, what lies outside does not count."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from roigs_engine.evaluation import metrics
from tests.engine.training.reference_loss import ssim_map


def picture(seed: int = 0, height: int = 40, width: int = 50) -> torch.Tensor:
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed))


def photo(seed: int = 0) -> torch.Tensor:
    return (picture(seed) * 255).round().to(torch.uint8)


def block(height: int = 40, width: int = 50) -> torch.Tensor:
    mask = torch.zeros(height, width, dtype=torch.bool)
    mask[12:25, 20:41] = True
    return mask


def psnr(image: torch.Tensor, target: torch.Tensor, mask: torch.Tensor | None = None) -> float:
    """As the evaluation computes it."""
    return metrics.psnr_from_mse(metrics.mean_in(metrics.squared_error(image, target), mask))


def test_psnr_of_a_known_error() -> None:
    target = torch.full((4, 5, 3), 0.5)
    assert psnr(target + 0.1, target) == pytest.approx(20.0, abs=1e-4)
    assert psnr(target + 0.01, target) == pytest.approx(40.0, abs=1e-3)


def test_psnr_averages_over_pixels_and_channels() -> None:
    target, image = torch.zeros(2, 2, 3), torch.zeros(2, 2, 3)
    image[0, 0, 1] = 0.6
    assert psnr(image, target) == pytest.approx(-10 * math.log10(0.36 / 12), abs=1e-5)
    corner = torch.tensor([[True, False], [False, False]])
    assert psnr(image, target, corner) == pytest.approx(-10 * math.log10(0.12), abs=1e-5)


def test_only_the_mask_counts() -> None:
    target, mask = picture(), block()
    image = target.clone()
    image[~mask] = 1 - image[~mask]
    assert psnr(image, target, mask) == metrics.MAX_PSNR
    assert psnr(image, target, ~mask) < 15


def test_equal_images() -> None:
    image = picture()
    assert psnr(image, image) == metrics.MAX_PSNR
    assert metrics.ssim(photo() / 255, photo(), block()) == pytest.approx(1.0, abs=1e-6)


def test_empty_mask_has_no_value() -> None:
    empty = torch.zeros(40, 50, dtype=torch.bool)
    assert math.isnan(psnr(picture(), picture(1), empty))
    assert math.isnan(metrics.ssim(picture(), photo(1), empty))
    assert metrics.bounding_box(empty) is None


def test_masked_ssim_is_that_of_wang_away_from_the_border() -> None:
    """Against scipy: 11 x 11 Gaussian window, sigma 1.5, K1 = 0.01, K2 = 0.03."""

    def blur(values: np.ndarray) -> np.ndarray:
        for axis in (0, 1):
            values = gaussian_filter1d(values, 1.5, axis=axis, mode="constant", truncate=5 / 1.5)
        return values

    image, target, mask = picture(2), photo(3), block()
    a, b = image.double().numpy(), target.double().numpy() / 255
    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2
    cov = blur(a * b) - mean_a * mean_b
    wang = (2 * mean_a * mean_b + 1e-4) * (2 * cov + 9e-4)
    wang /= (mean_a**2 + mean_b**2 + 1e-4) * (var_a + var_b + 9e-4)
    assert metrics.ssim(image, target, mask) == pytest.approx(wang[mask.numpy()].mean(), abs=1e-4)


@settings(max_examples=12)
@given(st.integers(0, 2**31), st.floats(0.001, 0.999))
def test_masked_ssim_is_the_mean_of_the_full_map(seed: int, share: float) -> None:
    image, target = picture(seed), photo(seed + 1)
    mask = torch.zeros(40, 50, dtype=torch.bool)
    rows = torch.arange(40)[:, None] < share * 40
    columns = torch.arange(50) > (1 - share) * 50
    mask |= rows & columns
    mask[0, 0] = True
    full = ssim_map(image, target).mean(dim=-1)
    assert metrics.ssim(image, target, mask) == pytest.approx(float(full[mask].mean()), abs=1e-5)


def test_bounding_box_stays_in_the_image() -> None:
    mask = block()
    assert metrics.bounding_box(mask) == (slice(12, 25), slice(20, 41))
    assert metrics.bounding_box(mask, 10) == (slice(2, 35), slice(10, 50))


def test_detail_sees_blur_and_no_light() -> None:
    random = torch.Generator().manual_seed(0)
    coarse = torch.rand(1, 3, 8, 10, generator=random)
    target = torch.nn.functional.interpolate(coarse, scale_factor=4, mode="nearest")[0]
    target = target.permute(1, 2, 0) * 0.8
    mask = torch.ones(32, 40, dtype=torch.bool)
    soft = torch.nn.functional.avg_pool2d(target.permute(2, 0, 1), 5, 1, 2, False, False)
    soft = soft.permute(1, 2, 0)
    brighter = target + 0.1
    blurred, light = (metrics.detail_error(x, target, mask) for x in (soft, brighter))
    assert light == pytest.approx(0, abs=1e-12)
    assert blurred > 1e-3
    assert math.isnan(metrics.detail_error(soft, target, ~mask))
    # of a part of the picture, that of the whole picture there
    error, part = (soft - target).double(), torch.zeros_like(mask)
    part[3:9, 30:40] = True
    smooth = gaussian_filter(error.numpy(), (2, 2, 0), mode="nearest", truncate=3)
    expected = float(((error.numpy() - smooth)[part.numpy()] ** 2).mean())
    assert metrics.detail_error(soft, target, part) == pytest.approx(expected, rel=1e-6)


def test_a_correction_multiplies_channels() -> None:
    random = torch.Generator().manual_seed(0)
    target = torch.rand(6, 8, 3, generator=random) * 0.8
    mask = torch.zeros(6, 8, dtype=torch.bool)
    mask[1:4, 2:7] = True
    image = target / torch.tensor([2.0, 1.0, 0.9])
    image[~mask] = 0  # does not matter
    assert metrics.corrected_error(image, target, mask) == pytest.approx(0, abs=1e-10)
    noise = torch.where(torch.rand(6, 8, 1, generator=random) < 0.5, 0.1, -0.1)
    assert metrics.corrected_error(image + noise, target, mask) > 1e-3
    assert metrics.corrected_error(torch.zeros_like(image), target, mask) > 0.01
    assert math.isnan(metrics.corrected_error(image, target, torch.zeros_like(mask)))
