"""Patches of a photo are found in another that is shifted, bent, brighter or coarser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from roigs_engine.colmap.patch_alignment import Pyramid, align, templates

SIDE = 200
PLACES = np.array([[60.5, 70.5], [120.3, 90.8], [99.9, 130.1]])
STRAIGHT = np.tile(np.eye(2), (3, 1, 1))


def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A smooth pattern without repetition; grey values at places in px."""
    rng = np.random.default_rng(2)
    value = np.full(x.shape, 127.0)
    for _ in range(40):
        fx, fy = rng.normal(scale=0.35, size=2)
        value += 11 * np.sin(fx * x + fy * y + rng.uniform(0, 6))
    return value


def photo(path: Path, matrix: np.ndarray, move: np.ndarray, gain: float = 1.0) -> Pyramid:
    """A photo whose place p shows what the first one has at matrix @ (p - move)."""
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    at = np.einsum("ij,jhw->ihw", matrix, np.stack([x - move[0], y - move[1]]))
    grey = np.clip(gain * (texture(*at) - 127) + 127, 0, 255).round().astype(np.uint8)
    Image.fromarray(np.repeat(grey[..., None], 3, axis=2)).save(path)
    return Pyramid(path, (SIDE, SIDE))


@pytest.mark.parametrize(
    ("matrix", "move", "gain"),
    [
        (np.eye(2), [0.37, -0.81], 1.0),
        (np.eye(2), [1.6, 1.1], 0.6),
        ([[1.08, 0.05], [-0.04, 0.95]], [3.0, -2.0], 1.0),
    ],
)
def test_places_are_found_to_a_few_hundredths(
    tmp_path: Path, matrix: np.ndarray, move: np.ndarray, gain: float
) -> None:
    matrix, move = np.array(matrix), np.array(move)
    one = photo(tmp_path / "a.png", np.eye(2), np.zeros(2))
    other = photo(tmp_path / "b.png", matrix, move, gain)
    truth = PLACES @ np.linalg.inv(matrix).T + move
    patches, usable = templates(one, PLACES, STRAIGHT)
    assert usable.all()
    start = truth + np.array([[0.9, -0.7], [-1.0, 0.4], [0.5, 0.8]])
    found, good, likeness = align(other, start, STRAIGHT, patches, np.full(3, 3.0))
    assert good.all() and likeness.min() > 0.98
    assert np.abs(found - truth).max() < 0.04


def test_a_coarser_photo_is_compared_at_its_own_size(tmp_path: Path) -> None:
    """The reference shows the object four times as large."""
    one = photo(tmp_path / "a.png", np.eye(2) / 2, np.zeros(2))
    other = photo(tmp_path / "b.png", np.eye(2) * 2, np.zeros(2))
    patches, _ = templates(one, PLACES[:1] * 1.5, 4 * STRAIGHT[:1])
    truth = PLACES[:1] * 1.5 / 4
    found, good, _ = align(other, truth + 0.6, STRAIGHT[:1], patches, np.full(1, 3.0))
    assert good.all() and np.abs(found - truth).max() < 0.08


def test_what_cannot_be_found_is_not_trusted(tmp_path: Path) -> None:
    one = photo(tmp_path / "a.png", np.eye(2), np.zeros(2))
    patches, _ = templates(one, PLACES, STRAIGHT)
    noise = np.random.default_rng(4).integers(0, 255, (SIDE, SIDE, 3)).astype(np.uint8)
    Image.fromarray(gaussian_filter(noise, (2, 2, 0))).save(tmp_path / "noise.png")
    other = Pyramid(tmp_path / "noise.png", (SIDE, SIDE))
    assert not align(other, PLACES, STRAIGHT, patches, np.full(3, 3.0))[1].any()
    beyond = PLACES + 15.0  # the same photo, but farther away than it may be
    assert not align(one, beyond, STRAIGHT, patches, np.full(3, 3.0))[1].any()


def test_a_reference_needs_contrast_and_must_be_whole(tmp_path: Path) -> None:
    flat = np.full((SIDE, SIDE, 3), 90, dtype=np.uint8)
    Image.fromarray(flat).save(tmp_path / "flat.png")
    assert not templates(Pyramid(tmp_path / "flat.png", (SIDE, SIDE)), PLACES, STRAIGHT)[1].any()
    one = photo(tmp_path / "a.png", np.eye(2), np.zeros(2))
    rim = np.array([[3.0, 50.0], [50.0, 198.0], [100.0, 100.0]])
    assert templates(one, rim, STRAIGHT)[1].tolist() == [False, False, True]


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (2, 2)])
def test_a_photo_smaller_than_a_patch_has_none(tmp_path: Path, size: tuple[int, int]) -> None:
    Image.new("RGB", size, (90, 90, 90)).save(tmp_path / "small.png")
    places = np.array([[0.5, 0.5], [1e9, -1e9], [np.nan, np.inf]])
    values, usable = templates(Pyramid(tmp_path / "small.png", size), places, STRAIGHT)
    assert np.isfinite(values).all() and not usable.any()


@pytest.mark.parametrize("ends", [0.0, 1.0])
def test_places_at_the_photos_edge_are_interpolated_in_it(tmp_path: Path, ends: float) -> None:
    """Also in a photo so wide that float32 cannot tell its last pixels from what is beyond."""
    width, height = 40_000, 40
    ramp = np.linspace(0, 255, width).round().astype(np.uint8)
    Image.fromarray(np.tile(ramp[None, :, None], (height, 1, 3))).save(tmp_path / "wide.png")
    photo = Pyramid(tmp_path / "wide.png", (width, height))
    inside = np.array(
        [[ends * (width - 17) + 8.5, 20.5], [ends * width, ends * height], [-9.0, 99]]
    )
    values, _ = photo.patches(inside, STRAIGHT)
    assert np.isfinite(values).all()
    assert np.abs(values).max() < 100
