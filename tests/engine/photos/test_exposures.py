"""Exposures in EXIF, and photos levelled by them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.photos.exposures import (
    APERTURE,
    EXIF_IFD,
    ISO,
    TIME,
    exif_exposure,
    levelled,
    relative_exposures,
    white,
)
from roigs_engine.photos.profiles import srgb_curve, srgb_values


def photo(path: Path, tags: dict[int, object]) -> Path:
    exif = Image.Exif()
    exif.get_ifd(EXIF_IFD).update(tags)
    Image.new("RGB", (8, 6), "grey").save(path, exif=exif)
    return path


def test_exposure_counts_stops_of_light(tmp_path: Path) -> None:
    usual = {TIME: 1 / 100, APERTURE: 2.8, ISO: 200}
    base = exif_exposure(photo(tmp_path / "a.jpg", usual))
    assert base is not None
    for change, stops in (({TIME: 1 / 50}, 1), ({ISO: 100}, -1), ({APERTURE: 5.6}, -2)):
        other = exif_exposure(photo(tmp_path / "b.jpg", {**usual, **change}))
        assert other is not None and abs(other - base - stops) < 0.01, change


@pytest.mark.parametrize(
    "tags", [{}, {TIME: 0.01}, {TIME: 0.0, ISO: 100}, {TIME: 0.01, ISO: 0}, {TIME: 1e30, ISO: 100}]
)
def test_missing_or_impossible_numbers_are_no_exposure(
    tmp_path: Path, tags: dict[int, object]
) -> None:
    assert exif_exposure(photo(tmp_path / "a.jpg", tags)) is None


@pytest.mark.parametrize("number", [1e308, 5e-324, float("nan"), float("inf"), -1.0])
def test_doubles_that_lie_are_no_exposure(tmp_path: Path, number: float) -> None:
    """EXIF may hold numbers whose products are no numbers."""
    tags, doubles = (TIME, ISO), 12
    own = b"".join(struct.pack("<HHII", tag, doubles, 1, 56 + 8 * k) for k, tag in enumerate(tags))
    main = struct.pack("<HHHIIIH", 1, EXIF_IFD, 4, 1, 26, 0, len(tags))
    exif = b"II*\0\x08\0\0\0" + main + own + bytes(4) + struct.pack("<2d", number, number)
    path = tmp_path / "a.png"
    Image.new("RGB", (8, 6), "grey").save(path, exif=exif)
    assert len(Image.open(path, formats=("PNG",)).getexif().get_ifd(EXIF_IFD)) == len(tags)
    assert exif_exposure(path) is None


def test_no_photo_is_no_exposure(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"no photo")
    assert exif_exposure(tmp_path / "a.jpg") is None


def test_a_lens_with_one_aperture_need_not_say_it(tmp_path: Path) -> None:
    dark, bright = (
        exif_exposure(photo(tmp_path / "a.jpg", {TIME: time, ISO: 100})) for time in (0.01, 0.04)
    )
    assert dark is not None and bright is not None and abs(bright - dark - 2) < 0.01


def test_exposures_are_relative_to_the_middle() -> None:
    assert relative_exposures({"a": -6.0, "b": -5.0, "c": -3.0}) == {"a": -1, "b": 0, "c": 2}
    assert relative_exposures({"a": -6.0, "b": -5.0, "c": None}) == {"a": -0.5, "b": 0.5}
    assert relative_exposures({"a": -6.0, "b": None, "c": None}) == {}  # too few
    assert relative_exposures({"a": -6.0, "b": -5.95}) == {}  # a twentieth of a stop


def test_levelling_undoes_an_exposure_in_linear_light() -> None:
    values = np.linspace(0.05, 0.5, 60)
    taken = {
        stops: (255 * srgb_values(srgb_curve(values) * 2.0**stops)).round().astype(np.uint8)
        for stops in (0, 1, -1)
    }
    for stops in (1, -1):
        back = levelled(taken[stops], stops)
        assert np.abs(back.astype(int) - taken[0]).max() <= 2
    assert levelled(taken[0], 0.0) is taken[0]


def test_brighter_photos_have_a_white_below_white() -> None:
    pixels = np.array([[[255, 10, 10], [235, 230, 240]]], np.uint8)
    for stops in (0.3, 1.0, 4.0):
        back = levelled(pixels, stops)
        assert 0 < back.max() == white(stops) < 255
        # nearly clipped values may be brighter, too
        assert back[0, 0, 0] == back[0, 1, 0] == back[0, 1, 2]
        assert back[0, 1, 1] < white(stops)
    assert white(1.0) < white(0.3)
    assert white(0.0) == white(-1.0) == 255  # white of a darker photo is whiter than the middle's
