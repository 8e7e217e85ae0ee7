"""Photos of more than 8 bits in other spaces than sRGB, and the one transparent colour of a PNG."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from roigs_engine.photos.colours import colours_in_words
from roigs_engine.photos.decode import decode
from roigs_engine.photos.headers import CONVERTED, PhotoError, photo_size
from roigs_engine.photos.mask_images import alpha_mask, has_alpha, read_mask
from roigs_engine.photos.profiles import SRGB, space_of_profile, srgb_curve
from tests.icc_profiles import LINEAR_PROFILE, P3_PROFILE, profile

# Of sRGB, most of them darker than the first step of 8 linear bits, which is 13
DARK = np.array([[2, 3, 4], [5, 6, 7], [8, 9, 10], [12, 14, 16], [30, 33, 36], [200, 210, 220]])
CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}  # of PNG's colour types


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(path: Path, values: np.ndarray, kind: int, *chunks: bytes, bits: int = 16) -> Path:
    """A PNG of (H, W, channels) values in 16 bits, or in fewer for grey."""
    height, width = values.shape[:2]
    if bits == 16:
        rows = [row.astype(">u2").tobytes() for row in values]
    else:
        planes = np.unpackbits(values.astype(np.uint8)[..., None], axis=-1)[..., 8 - bits :]
        rows = [np.packbits(row).tobytes() for row in planes]
    header = struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0)
    data = chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row for row in rows)))
    parts = [chunk(b"IHDR", header), *chunks, data, chunk(b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    return path


def embedded(icc: bytes) -> bytes:
    return chunk(b"iCCP", b"p\0\0" + zlib.compress(icc))


def stored(light: np.ndarray) -> np.ndarray:
    """(4, 6, channels) uint16, a column for each colour."""
    values = (light * 65535).round().astype(np.uint16)
    return np.broadcast_to(values, (4, *values.shape)).copy()


def grey_profile(curve: bytes, connection: bytes = b"XYZ ") -> bytes:
    white = struct.pack(">4s4x3i", b"XYZ ", 63190, 65536, 54061)
    table = struct.pack(">I4sII4sII", 2, b"wtpt", 156, 20, b"kTRC", 176, len(curve))
    head = struct.pack(">I4xI4s4s4s12x4s", 176 + len(curve), 0x02400000, b"mntr", b"GRAY",
                       connection, b"acsp")  # fmt: skip
    return (head.ljust(68, b"\0") + white[8:]).ljust(128, b"\0") + table + white + curve


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("named", ["iCCP", "gAMA", "cICP"])
def test_shadows_of_a_linear_png_stay(tmp_path: Path, named: str, alpha: bool) -> None:
    says = {
        "iCCP": embedded(LINEAR_PROFILE),
        "gAMA": chunk(b"gAMA", struct.pack(">I", 100000)),
        "cICP": chunk(b"cICP", bytes([1, 8, 0, 1])),
    }[named]
    values = stored(srgb_curve(DARK / 255))
    if alpha:
        values = np.dstack([values, np.full((4, 6), 65535, np.uint16)])
    path = png(tmp_path / "a.png", values, 6 if alpha else 2, says)
    assert np.abs(decode(path)[1].astype(int) - DARK).max() == 0
    assert decode(path, (3, 2)).shape == (2, 3, 3)


@pytest.mark.parametrize("kind", ["<u2", ">u2", "packed", "alpha", "associated", "f4", "planes"])
def test_shadows_of_a_linear_tiff_stay(tmp_path: Path, kind: str) -> None:
    tifffile = pytest.importorskip("tifffile")
    path, values = tmp_path / "a.tif", stored(srgb_curve(DARK / 255))
    options: dict[str, Any] = {"photometric": "rgb", "iccprofile": LINEAR_PROFILE}
    if kind == "packed":
        options |= {"compression": "zlib", "byteorder": ">"}
    elif kind in ("<u2", ">u2"):
        options |= {"byteorder": kind[0]}
    elif kind == "planes":
        options |= {"planarconfig": "separate"}
        values = np.moveaxis(values, -1, 0).copy()
    elif kind == "f4":
        values = np.broadcast_to(srgb_curve(DARK / 255).astype(np.float32), (4, 6, 3)).copy()
    else:
        half = np.full((4, 6), 32768, np.uint16)
        if kind == "associated":
            values = (values / 65535 * 32768).round().astype(np.uint16)
        values = np.dstack([values, half])
        options["extrasamples"] = ["unassalpha" if kind == "alpha" else "assocalpha"]
    if kind == "packed":
        pytest.importorskip("imagecodecs")
    tifffile.imwrite(path, values, **options)
    assert np.abs(decode(path)[1].astype(int) - DARK).max() <= (kind == "associated")


def test_a_deep_tiff_is_not_turned_by_its_tag(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    values = stored(srgb_curve(DARK / 255))
    turned = [(274, 3, 1, 6, True)]
    tifffile.imwrite(
        tmp_path / "a.tif", values, photometric="rgb", iccprofile=LINEAR_PROFILE, extratags=turned
    )
    assert np.array_equal(decode(tmp_path / "a.tif")[1], DARK)


def test_an_interlaced_png(tmp_path: Path) -> None:
    values = np.tile(stored(srgb_curve(DARK / 255)), (4, 3, 1))
    passes = [
        (0, 0, 8, 8),
        (0, 4, 8, 8),
        (4, 0, 8, 4),
        (0, 2, 4, 4),
        (2, 0, 4, 2),
        (0, 1, 2, 2),
        (1, 0, 2, 1),
    ]  # first row and column, and steps: PNG, 8.1
    rows = [row for y, x, down, across in passes for row in values[y::down, x::across]]
    data = b"".join(b"\0" + row.astype(">u2").tobytes() for row in rows)
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 18, 16, 16, 2, 0, 0, 1))
    parts = [
        header,
        embedded(LINEAR_PROFILE),
        chunk(b"IDAT", zlib.compress(data)),
        chunk(b"IEND", b""),
    ]
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    assert np.array_equal(decode(tmp_path / "a.png")[1], np.tile(DARK, (3, 1)))


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("exponent", [1.0, 1.8])
def test_a_grey_png_with_a_profile_of_grey(tmp_path: Path, exponent: float, alpha: bool) -> None:
    """Pillow opens 16 bits of grey with alpha as RGBA."""
    grey = DARK[:, :1]
    values = stored(srgb_curve(grey / 255) ** (1 / exponent))
    if alpha:
        values = np.dstack([values, np.full((4, 6), 65535, np.uint16)])
    says = embedded(grey_profile(struct.pack(">4s4xIH", b"curv", 1, round(exponent * 256))))
    path = png(tmp_path / "a.png", values, 4 if alpha else 0, says)
    assert colours_in_words(path) == CONVERTED
    assert np.abs(decode(path)[1].astype(int) - grey).max() <= 1


@pytest.mark.parametrize("kind", [0, 4])
def test_a_profile_that_is_no_matrix_is_applied_to_rounded_values(
    tmp_path: Path, kind: int
) -> None:
    """Of L*: 50 is 18.4 % of light (CIE 1976), 119 in sRGB."""
    says = embedded(grey_profile(struct.pack(">4s4xI", b"curv", 0), b"Lab "))
    values = np.full((4, 6, CHANNELS[kind]), 0x7FFF, np.uint16)  # 127 if it is cut, 128 if rounded
    path = png(tmp_path / "a.png", values, kind, says)
    assert space_of_profile(grey_profile(struct.pack(">4s4xI", b"curv", 0), b"Lab ")) is None
    assert np.abs(decode(path).astype(int) - 119).max() <= 1


def test_a_photo_in_srgb_keeps_its_bytes(tmp_path: Path) -> None:
    values = np.random.default_rng(0).integers(0, 65536, (4, 6, 3)).astype(np.uint16)
    plain = png(tmp_path / "a.png", values, 2)
    tagged = png(tmp_path / "b.png", values, 2, embedded(profile(SRGB, srgb_curve)))
    assert np.array_equal(decode(plain), values >> 8)
    assert np.array_equal(decode(tagged), values >> 8)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("code", [(1, 13), (1, 1), (12, 13)])
def test_limited_range_of_a_png(tmp_path: Path, bits: int, code: tuple[int, int]) -> None:
    """ITU-T H.273, 8.3: black is 16 of 255 and white 235, in 16 bits 256 times that."""
    grey = np.array([0, 2, 60, 128, 200, 255])
    values = np.repeat((16 + 219 * grey / 255)[:, None] * 2 ** (bits - 8), 3, axis=1).round()
    values = np.broadcast_to(values.astype(np.uint16), (4, 6, 3))
    says = chunk(b"cICP", bytes([*code, 0, 0]))
    path = tmp_path / "a.png"
    if bits == 16:
        png(path, np.dstack([values, np.full((4, 6), 4096, np.uint16)]), 6, says)
        assert not alpha_mask(path).any()  # is never limited
    else:
        Image.fromarray(values.astype(np.uint8)).save(path)
        data = path.read_bytes()
        path.write_bytes(data[:33] + says + data[33:])
    assert np.abs(decode(path)[1].astype(int) - grey[:, None]).max() <= 1
    assert colours_in_words(path) == CONVERTED


@pytest.mark.parametrize(("bits", "clear"), [(1, 1), (2, 2), (4, 9), (8, 200), (16, 30000)])
def test_the_transparent_grey_of_a_png(tmp_path: Path, bits: int, clear: int) -> None:
    """tRNS has a value as it is stored (PNG, 11.3.1.1): with 16 bits, its neighbour is opaque."""
    seen = np.array([clear - 1, clear] * 4)
    values = np.broadcast_to(seen, (4, 8))[..., None]
    says = chunk(b"tRNS", struct.pack(">H", clear))
    path = png(tmp_path / "a.png", values, 0, says, bits=bits)
    right = np.broadcast_to(seen != clear, (4, 8))
    assert has_alpha(path)
    assert np.array_equal(alpha_mask(path), right)
    assert np.array_equal(read_mask(path, (8, 4)), right & (values[..., 0] > 0))


def test_the_transparent_colour_of_a_png_of_16_bits(tmp_path: Path) -> None:
    values = np.full((4, 8, 3), 30000)
    values[:, 4:, 2] = 30001
    path = png(tmp_path / "a.png", values, 2, chunk(b"tRNS", struct.pack(">3H", *[30000] * 3)))
    right = np.broadcast_to(np.arange(8) >= 4, (4, 8))
    assert np.array_equal(alpha_mask(path), right)
    assert np.array_equal(read_mask(path, (8, 4)), right)


def test_transparent_pixels_of_16_bits_leave_no_colour(tmp_path: Path) -> None:
    values = np.full((8, 16, 1), 20000)
    values[:, :7] = 65535
    path = png(tmp_path / "a.png", values, 0, chunk(b"tRNS", struct.pack(">H", 65535)))
    assert np.all(decode(path, (8, 4))[:, 3:] == 20000 >> 8)


def test_a_mask_of_16_bits_ignores_only_black(tmp_path: Path) -> None:
    values = np.zeros((4, 8, 3))
    values[:, 4:, 1] = 1
    right = np.broadcast_to(np.arange(8) >= 4, (4, 8))
    assert np.array_equal(read_mask(png(tmp_path / "a.png", values, 2), (8, 4)), right)


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [
        (0, [1.8]),
        (1, [2.0, 1.25, -0.25]),
        (3, [2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045]),
        (4, [2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045, 0.0, 0.0]),
    ],
)
def test_parametric_curves(kind: int, numbers: list[float]) -> None:
    """parametricCurveType (ICC.1, 10.18)."""
    fixed = b"".join(struct.pack(">i", round(65536 * number)) for number in numbers)
    space = space_of_profile(grey_profile(struct.pack(">4s4xHH", b"para", kind, 0) + fixed))
    assert space is not None
    x = np.linspace(0, 1, 65536)
    right = {0: x**1.8, 1: np.maximum(1.25 * x - 0.25, 0) ** 2}.get(kind, srgb_curve(x))
    assert np.abs(space.curves[0] - right).max() < 1e-4


def test_the_matrix_of_a_profile_is_that_of_littlecms() -> None:
    """P3's red lies outside sRGB: 1.2249, -0.0421, -0.0196 of its light."""
    space = space_of_profile(P3_PROFILE)
    assert space is not None and space.matrix is not None
    assert np.allclose(space.matrix[:, 0], [1.2249, -0.0421, -0.0196], atol=1e-3)
    assert np.allclose(space.matrix.sum(axis=1), 1, atol=1e-3)
    tables = P3_PROFILE.replace(b"cprt", b"A2B0", 1)
    assert space_of_profile(tables) is None


@pytest.mark.parametrize("kind", ["png", "png with alpha", "float TIFF", "TIFF of planes"])
def test_memory_of_large_deep_photos(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """As many bytes a pixel as the file and the picture have: 178 million took 4 to 6 GB."""
    monkeypatch.setattr("roigs_engine.photos.profiles.PART", 1 << 12)
    values = np.random.default_rng(0).integers(0, 65536, (500, 800, 4), dtype=np.uint16)
    wide = P3_PROFILE
    path = tmp_path / ("a.png" if "png" in kind else "a.tif")
    if "png" in kind:
        alpha = "alpha" in kind
        icc = chunk(b"iCCP", b"p\0\0" + zlib.compress(wide))
        png(path, values if alpha else values[..., :3], 6 if alpha else 2, icc)
    else:
        tifffile = pytest.importorskip("tifffile")
        rgb = values[..., :3]
        rgb = (rgb / 65535).astype(np.float32) if "float" in kind else rgb.transpose(2, 0, 1)
        planes = {"planarconfig": "separate"} if "planes" in kind else {}
        tifffile.imwrite(path, rgb, photometric="rgb", **planes)
    decode(path)  # what is imported and kept
    tracemalloc.start()
    decode(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak / values[..., 0].size < (24 if "float" in kind else 14)


@pytest.mark.parametrize("size", [(70_000, 2), (2, 70_000)])
def test_photos_with_a_very_long_side_are_refused(tmp_path: Path, size: tuple[int, int]) -> None:
    Image.new("L", size).save(tmp_path / "a.png")
    with pytest.raises(PhotoError, match=r"70000.*or 65,535 on a side"):
        photo_size(tmp_path / "a.png")
