"""FLIP over masks: the package is asked for the right pixels, and is not needed."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from roigs_engine.evaluation import metrics as module
from roigs_engine.evaluation.metrics import FLIP_RADIUS, flip


def pictures(height: int = 60, width: int = 80) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    target = torch.rand(height, width, 3, generator=generator)
    noise = 0.2 * torch.randn(height, width, 3, generator=generator)
    return (target + noise).clamp(0, 1), target


def slanted(height: int = 60, width: int = 80) -> torch.Tensor:
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return (rows > 15) & (rows < 45) & (columns > rows) & (columns < rows + 12)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """A package whose error is the first channel's difference; the sizes that it is given."""
    sizes = []

    def evaluate(reference: np.ndarray, test: np.ndarray, kind: str, **options: bool) -> tuple:
        assert kind == "LDR" and options == {"applyMagma": False, "computeMeanError": False}
        for array in (reference, test):
            assert array.dtype == np.float32 and array.flags.c_contiguous
        sizes.append(reference.shape[:2])
        return np.abs(reference - test)[..., :1], -1.0, {}

    monkeypatch.setitem(sys.modules, "flip_evaluator", SimpleNamespace(evaluate=evaluate))
    return sizes


def test_the_mean_is_that_of_the_mask(fake: list[tuple[int, int]]) -> None:
    image, target = torch.zeros(30, 50, 3), torch.zeros(30, 50, 3)
    image[:, :, 1] = 1.0
    image[20, 25, 0], image[20, 26, 0], image[20, 27, 0] = 0.2, 0.6, 0.9
    mask = torch.zeros(30, 50, dtype=torch.bool)
    mask[20, 25:27] = True
    assert flip(image, target, mask) == pytest.approx(0.4)
    assert fake == [(10 + FLIP_RADIUS, 2 + 2 * FLIP_RADIUS)]  # the image ends 9 rows below


def test_strips_of_rows_give_the_same(
    fake: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    image, target = pictures()
    whole = flip(image, target, slanted())
    monkeypatch.setattr(module, "PIXELS_AT_ONCE", 7 * 80)
    assert flip(image, target, slanted()) == pytest.approx(whole)
    assert len(fake) == 1 + 5


def test_there_is_none_without_the_package_or_pixels(
    fake: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    image, target = pictures()
    assert flip(image, target, torch.zeros(60, 80, dtype=torch.bool)) is None
    assert fake == []
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    assert flip(image, target, slanted()) is None


def test_the_package_gives_the_error_of_the_whole_pictures(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    package = pytest.importorskip("flip_evaluator")
    image, target = pictures()
    errors = package.evaluate(target.numpy(), image.numpy(), "LDR", applyMagma=False)[0][..., 0]
    expected = errors[slanted().numpy()].mean()
    assert 0.1 < expected < 0.9
    assert flip(image, target, slanted()) == pytest.approx(expected, abs=1e-6)
    monkeypatch.setattr(module, "PIXELS_AT_ONCE", 7 * 80)
    assert flip(image, target, slanted()) == pytest.approx(expected, abs=1e-6)
    assert flip(target, target, slanted()) == 0
