"""Rotation tags of photos: where they are found, and what they do to pixels."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageOps

from roigs_engine.photos.decode import decode
from roigs_engine.photos.headers import photo_size
from roigs_engine.photos.rotation import AS_STORED, rotation_tag, turned, turned_size

NOISE = np.random.default_rng(0).integers(0, 256, (30, 47, 3), dtype=np.uint8)


def tagged(path: Path, tag: int, pixels: np.ndarray = NOISE) -> Path:
    exif = Image.Exif()
    exif[0x0112] = tag
    Image.fromarray(pixels).save(path, exif=exif)
    return path


@pytest.mark.parametrize("tag", range(1, 9))
def test_pixels_are_turned_as_by_pillow(tmp_path: Path, tag: int) -> None:
    path = tagged(tmp_path / "a.png", tag)
    with Image.open(path) as photo:
        right = np.asarray(ImageOps.exif_transpose(photo))
    assert rotation_tag(path) == tag
    np.testing.assert_array_equal(decode(path, turn=tag), right)
    np.testing.assert_array_equal(turned(NOISE, tag), right)
    assert turned_size((47, 30), tag) == right.shape[1::-1]
    np.testing.assert_array_equal(decode(path), NOISE)


@pytest.mark.parametrize("tag", [3, 6, 8])
def test_a_smaller_photo_is_turned_too(tmp_path: Path, tag: int) -> None:
    y, x = np.mgrid[:256, :384]
    pixels = np.stack([x * 255 // 383, y, np.full_like(x, 90)], axis=-1).astype(np.uint8)
    path = tagged(tmp_path / "a.jpg", tag, pixels)
    size = turned_size((96, 64), tag)
    with Image.open(path) as photo:
        right = ImageOps.exif_transpose(photo).resize(size, Image.Resampling.LANCZOS)
    found = decode(path, size, tag).astype(int)
    assert np.abs(found - np.asarray(right)).max() <= 6


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.webp", "a.tif"])
def test_tags_of_each_format(tmp_path: Path, name: str) -> None:
    assert rotation_tag(tagged(tmp_path / name, 6)) == 6
    assert rotation_tag(tagged(tmp_path / name, 99)) == AS_STORED


@pytest.mark.parametrize("tag", [3, 6])
@pytest.mark.parametrize("compression", ["raw", "tiff_lzw"])
def test_a_tiff_is_not_turned_by_its_reader(tmp_path: Path, tag: int, compression: str) -> None:
    exif = Image.Exif()
    exif[0x0112] = tag
    path = tmp_path / "a.tif"
    Image.fromarray(NOISE).save(path, exif=exif, compression=compression)
    assert photo_size(path) == (47, 30)
    np.testing.assert_array_equal(decode(path), NOISE)
    np.testing.assert_array_equal(decode(path, turn=tag), turned(NOISE, tag))
    assert decode(path, (20, 13)).shape == (13, 20, 3)


def test_a_png_can_have_its_tag_after_the_pixels(tmp_path: Path) -> None:
    data = tagged(tmp_path / "a.png", 1).read_bytes()
    exif = b"II*\0\x08\0\0\0\x01\0" + struct.pack("<HHIHH", 0x0112, 3, 1, 8, 0) + bytes(4)
    chunk = struct.pack(">I", len(exif)) + b"eXIf" + exif
    chunk += struct.pack(">I", zlib.crc32(chunk[4:]))
    plain = data[:33] + data[data.index(b"IDAT") - 4 : -12]
    (tmp_path / "a.png").write_bytes(plain + chunk + data[-12:])
    assert rotation_tag(tmp_path / "a.png") == 8


def test_damaged_tags_ask_for_nothing(tmp_path: Path) -> None:
    data = tagged(tmp_path / "a.jpg", 6).read_bytes()
    at = data.index(b"Exif\0\0") + 6
    for end in range(8, 22):  # the EXIF data are cut, their segment is not
        broken = data[: at + end] + bytes(40)
        (tmp_path / "a.jpg").write_bytes(broken)
        assert rotation_tag(tmp_path / "a.jpg") in (AS_STORED, 6)
    assert rotation_tag(tmp_path / "missing.jpg") == AS_STORED
