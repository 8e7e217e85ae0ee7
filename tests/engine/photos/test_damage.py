"""Damaged photos are found by decoding them once; healthy ones of every kind pass."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.photos.decode import check_whole
from roigs_engine.photos.headers import PhotoError, check_complete
from tests.engine.deep_png import write_png16

END = b"\xff\xd9"


def photo(width: int = 640, height: int = 427) -> Image.Image:
    """Smooth colours with some noise."""
    rng = np.random.default_rng(3)
    coarse = Image.fromarray(rng.integers(0, 256, (9, 12, 3), dtype=np.uint8))
    smooth = np.asarray(coarse.resize((width, height)), np.int16)
    noisy = smooth + rng.integers(-9, 10, smooth.shape)
    return Image.fromarray(noisy.clip(0, 255).astype(np.uint8))


def jpeg(**options: object) -> bytes:
    """A JPEG with a small copy in its headers, as cameras write them."""
    small = io.BytesIO()
    photo(160, 107).save(small, "JPEG")
    file = io.BytesIO()
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\0\0\0\0\0" + small.getvalue()
    photo().save(file, "JPEG", quality=92, **{"exif": exif, **options})
    return file.getvalue()


@pytest.mark.parametrize("keep", [0.999, 0.9, 0.5, 0.2])
@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"restart_marker_rows": 4}])
def test_a_jpeg_that_breaks_off(tmp_path: Path, keep: float, options: dict[str, object]) -> None:
    """The end marker of the small copy in its headers is not taken for the photo's."""
    path, data = tmp_path / "a.jpg", jpeg(**options)
    path.write_bytes(data)
    check_complete(path)
    check_whole(path)
    path.write_bytes(data[: int(len(data) * keep)])
    for check in (check_complete, check_whole):
        with pytest.raises(PhotoError, match=r"a\.jpg"):
            check(path)


@pytest.mark.parametrize("fill", ["end", "zeros"])
@pytest.mark.parametrize("keep", [0.99, 0.6, 0.2])
def test_a_jpeg_that_ends_early_with_an_end_marker(tmp_path: Path, keep: float, fill: str) -> None:
    """Pillow reads such a file without a word, and fills it with one colour."""
    path, data = tmp_path / "a.jpg", jpeg()
    cut = data[: int(len(data) * keep)]
    path.write_bytes(cut + (b"" if fill == "end" else bytes(40)) + END)
    Image.open(path).load()
    with pytest.raises(PhotoError, match="end before the photo does"):
        check_whole(path)


@pytest.mark.parametrize("seed", range(20))
def test_a_jpeg_with_a_block_of_other_bytes(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = bytearray(jpeg())
    at = rng.integers(20_000, len(data) - 4096)
    data[at : at + 4096] = rng.bytes(4096)
    (tmp_path / "a.jpg").write_bytes(data)
    with pytest.raises(PhotoError):
        check_whole(tmp_path / "a.jpg")


@pytest.mark.parametrize("place", ["pixels", "checksum", "cut"])
def test_a_png_with_damage(tmp_path: Path, place: str) -> None:
    path = tmp_path / "a.png"
    photo(200, 150).save(path)
    check_whole(path)
    data = bytearray(path.read_bytes())
    if place == "cut":
        data = data[: len(data) // 2] + data[-12:]  # with its end marker
    else:
        data[len(data) // 2 if place == "pixels" else data.index(b"IEND") - 5] ^= 16
    path.write_bytes(data)
    with pytest.raises(PhotoError, match=r"a\.png"):
        check_whole(path)


@pytest.mark.parametrize("color", [(0, 0, 0), (255, 255, 255), (90, 120, 30)])
@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"optimize": True}])
def test_flat_photos_are_whole(
    tmp_path: Path, color: tuple[int, int, int], options: dict[str, object]
) -> None:
    """Also where a corner or all of the photo has one colour."""
    flat, half = Image.new("RGB", (333, 222), color), photo()
    half.paste(color, (0, 200, 640, 427))
    for index, picture in enumerate((flat, half, flat.convert("L"), half.convert("CMYK"))):
        path = tmp_path / f"{index}.jpg"
        picture.save(path, **options)
        check_whole(path)
        path.write_bytes(path.read_bytes() + b"film" * 50_000)  # as phones append it
        check_whole(path)


@pytest.mark.parametrize("suffix", ["png", "tif", "bmp", "webp", "jp2", "ppm"])
@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_other_kinds(tmp_path: Path, suffix: str, mode: str) -> None:
    path = tmp_path / f"a.{suffix}"
    photo(64, 48).convert(mode).save(path)
    check_whole(path)
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(PhotoError):
        check_whole(path)


@pytest.mark.parametrize(
    ("most", "tone"), [(65535, ""), (30000, ""), (16383, "black"), (4095, "black")]
)
def test_integers_that_do_not_fill_their_type(tmp_path: Path, most: int, tone: str) -> None:
    values = np.random.default_rng(0).integers(0, most, (20, 30, 3)).astype(np.uint16)
    write_png16(tmp_path / "a.png", values)
    Image.fromarray(values[..., 0]).save(tmp_path / "b.tif")
    assert [check_whole(tmp_path / name) for name in ("a.png", "b.tif")] == [tone, tone]


@pytest.mark.parametrize(("most", "tone"), [(1, ""), (0.1, "black"), (255, "white")])
def test_floats_of_another_range(tmp_path: Path, most: float, tone: str) -> None:
    values = np.random.default_rng(0).uniform(0, most, (20, 30)).astype(np.float32)
    values[0, 0] = np.nan
    Image.fromarray(values).save(tmp_path / "a.tif")
    assert check_whole(tmp_path / "a.tif") == tone


@pytest.mark.parametrize("size", [(1, 1), (5, 40), (40, 7)])
def test_tiny_jpegs_are_whole(tmp_path: Path, size: tuple[int, int]) -> None:
    Image.effect_noise(size, 50).convert("RGB").save(tmp_path / "a.jpg")
    check_whole(tmp_path / "a.jpg")
