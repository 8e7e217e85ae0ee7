"""Photos that are not in sRGB: every way in which a file says so, and profiles that are damaged."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageCms

from roigs_engine.context import Context
from roigs_engine.formats.events import Event, Message
from roigs_engine.photos.colours import colours_in_words
from roigs_engine.photos.contents import read_contents
from roigs_engine.photos.decode import decode
from roigs_engine.photos.headers import CONVERTED, DAMAGED
from roigs_engine.photos.profiles import ADOBE_GAMMA, SRGB, space_of_profile, srgb_curve
from tests.icc_profiles import ADOBE_PROFILE, P3, P3_PROFILE, power_curve, profile

# Colours of sRGB, and the same in other spaces, by the matrices that these are published with.
WANTED = np.array([[200, 40, 40], [40, 180, 60], [50, 60, 200], [128, 128, 128], [250, 240, 230]])
SRGB_TO_P3 = [[0.8224621, 0.1775380, 0], [0.0331941, 0.9668058, 0], [0.0170827, 0.0723974, 0.91052]]
SRGB_TO_ADOBE = [[0.7151256, 0.2848744, 0], [0, 1, 0], [0, 0.0411619, 0.9588381]]
SRGB_TO_2020 = [
    [0.6274039, 0.3292830, 0.0433131],
    [0.0690973, 0.9195404, 0.0113623],
    [0.0163914, 0.0880133, 0.8955953],
]


def linear(values: np.ndarray) -> np.ndarray:
    values = values / 255
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def stored(matrix: Any = None, exponent: float | None = None) -> Image.Image:
    """The colours as 40 x 8 pixels, stored in another space."""
    light = linear(WANTED) @ np.array(np.eye(3) if matrix is None else matrix).T
    if exponent is None:
        values = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    else:
        values = light ** (1 / exponent)
    values = (255 * values).round().astype(np.uint8)
    return Image.fromarray(np.broadcast_to(np.repeat(values, 8, axis=0), (8, 40, 3)).copy())


def off_by(path: Path, wanted: np.ndarray = WANTED) -> int:
    """The largest difference from the right values, in the middle of each colour."""
    return int(np.abs(decode(path)[4, 4::8].astype(int) - wanted).max())


def png(path: Path, pixels: Image.Image, *chunks: tuple[bytes, bytes]) -> Path:
    """A PNG with chunks after its header."""
    file = io.BytesIO()
    pixels.save(file, "PNG")
    data = file.getvalue()
    made = b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )
    path.write_bytes(data[:33] + made + data[33:])
    return path


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp"])
@pytest.mark.parametrize("space", ["P3", "Adobe"])
def test_embedded_profiles(tmp_path: Path, suffix: str, space: str) -> None:
    pixels = stored(SRGB_TO_P3) if space == "P3" else stored(SRGB_TO_ADOBE, ADOBE_GAMMA)
    options: dict[str, Any] = {"jpg": {"quality": 100, "subsampling": 0}}.get(suffix, {})
    options |= {"lossless": True} if suffix == "webp" else {}
    path = tmp_path / f"a.{suffix}"
    pixels.save(path, icc_profile=P3_PROFILE if space == "P3" else ADOBE_PROFILE, **options)
    assert off_by(path) <= 3
    small = decode(path, (20, 4))
    assert np.abs(small[2, 2::4].astype(int) - WANTED).max() <= 5  # the filter rings
    assert colours_in_words(path) == CONVERTED


def test_reduced_decoding_converts_too(tmp_path: Path) -> None:
    pixels = stored(SRGB_TO_P3).resize((1600, 320), Image.Resampling.NEAREST)
    pixels.save(tmp_path / "a.jpg", icc_profile=P3_PROFILE, quality=98, subsampling=0)
    assert np.abs(decode(tmp_path / "a.jpg", (40, 8))[4, 4::8].astype(int) - WANTED).max() <= 3


def test_a_jpeg_2000_and_a_bmp(tmp_path: Path) -> None:
    """Pillow hands on the profile of neither."""
    stored(SRGB_TO_P3).save(tmp_path / "a.jp2")
    data = (tmp_path / "a.jp2").read_bytes()
    at = data.index(b"colr") - 4
    old = struct.unpack(">I", data[at : at + 4])[0]
    box = struct.pack(">I4s3B", 11 + len(P3_PROFILE), b"colr", 2, 0, 0) + P3_PROFILE
    head = data.index(b"jp2h") - 4
    size = struct.unpack(">I", data[head : head + 4])[0] + len(box) - old
    data = data[:head] + struct.pack(">I", size) + data[head + 4 : at] + box + data[at + old :]
    (tmp_path / "a.jp2").write_bytes(data)
    assert off_by(tmp_path / "a.jp2") <= 3
    stored(SRGB_TO_P3).save(tmp_path / "a.bmp")
    data = (tmp_path / "a.bmp").read_bytes()
    head, rows = data[14:54], data[54:]
    head = struct.pack("<I", 124) + head[4:] + b"\0" * 16 + b"DEBM" + b"\0" * 52
    head += struct.pack("<II4x", 124 + len(rows), len(P3_PROFILE))
    start = struct.pack("<2sI4xI", b"BM", 14 + 124 + len(rows) + len(P3_PROFILE), 14 + 124)
    (tmp_path / "a.bmp").write_bytes(start + head + rows + P3_PROFILE)
    assert off_by(tmp_path / "a.bmp") <= 2


CHRM_P3 = struct.pack(">8I", *(round(100000 * v) for v in (0.3127, 0.329, 0.68, 0.32)),
                      *(round(100000 * v) for v in (0.265, 0.69, 0.15, 0.06)))  # fmt: skip
GAMA = struct.pack(">I", 45455)
P3_CHUNK = (b"iCCP", b"p\0\0" + zlib.compress(P3_PROFILE))


@pytest.mark.parametrize(
    ("matrix", "exponent", "chunks"),
    [
        (SRGB_TO_P3, None, [(b"cICP", bytes([12, 13, 0, 1]))]),
        (SRGB_TO_2020, 1.0, [(b"cICP", bytes([9, 8, 0, 1]))]),
        (None, None, [(b"cICP", bytes([1, 13, 0, 1])), P3_CHUNK]),
        (SRGB_TO_P3, None, [(b"gAMA", GAMA), (b"cHRM", CHRM_P3)]),
        (None, 1.0, [(b"gAMA", struct.pack(">I", 100000))]),
        (None, 1.8, [(b"gAMA", struct.pack(">I", 55556))]),
        (None, None, [(b"gAMA", GAMA)]),
        (None, None, [(b"sRGB", b"\0"), (b"gAMA", struct.pack(">I", 100000)), (b"cHRM", CHRM_P3)]),
        (SRGB_TO_P3, None, [(b"gAMA", struct.pack(">I", 100000)), P3_CHUNK]),
    ],
)
def test_chunks_of_a_png(
    tmp_path: Path, matrix: Any, exponent: float | None, chunks: list[tuple[bytes, bytes]]
) -> None:
    """In the order of the specification: cICP, iCCP, sRGB, then gAMA and cHRM."""
    assert off_by(png(tmp_path / "a.png", stored(matrix, exponent), *chunks)) <= 3


@pytest.mark.parametrize(
    ("code", "value", "light"), [(16, 148, 1.0), (18, 191, 1.0), (16, 77, 10 / 203)]
)
def test_hdr_is_tone_mapped_to_the_reference_white(
    tmp_path: Path, code: int, value: int, light: float
) -> None:
    """203 cd/m2 are 58 % of PQ and 75 % of HLG (ITU-R BT.2408); 10 cd/m2 are 30 % of PQ."""
    grey = Image.new("RGB", (40, 8), (value,) * 3)
    path = png(tmp_path / "a.png", grey, (b"cICP", bytes([9, code, 0, 1])))
    right = 255 * (1.055 * light ** (1 / 2.4) - 0.055)
    assert np.abs(decode(path).astype(float) - right).max() <= 3


@pytest.mark.parametrize(
    ("space", "index", "adobe"),
    [(2, None, True), (0xFFFF, "R03", True), (0xFFFF, "R98", False), (1, "R03", False)],
)
def test_adobe_rgb_by_exif(tmp_path: Path, space: int, index: str | None, adobe: bool) -> None:
    exif = Image.Exif()
    exif[0x8769] = {0xA001: space} | ({0xA005: {1: index}} if index else {})
    pixels = stored(SRGB_TO_ADOBE, ADOBE_GAMMA) if adobe else stored()
    pixels.save(tmp_path / "a.jpg", exif=exif, quality=100, subsampling=0)
    assert off_by(tmp_path / "a.jpg") <= 3


@pytest.mark.parametrize("mode", ["L", "I;16", "F"])
@pytest.mark.parametrize("kind", ["RGB", "GRAY"])
def test_grey_photos(tmp_path: Path, mode: str, kind: str) -> None:
    """With a profile of grey, or of RGB, as many programs embed it."""
    linear_light = profile(P3, power_curve(1.0))
    if kind == "GRAY":
        curve = struct.pack(">4s4xI", b"curv", 0)  # linear
        white = struct.pack(">4s4x3i", b"XYZ ", 63190, 65536, 54061)
        table = struct.pack(">I4sII4sII", 2, b"wtpt", 156, 20, b"kTRC", 176, 12)
        linear_light = (struct.pack(">I4xI4s4s4s12x4s", 188, 0x02400000, b"mntr", b"GRAY", b"XYZ ",
                        b"acsp").ljust(68, b"\0") + white[8:]).ljust(128, b"\0")  # fmt: skip
        linear_light += table + white + curve
    values = np.broadcast_to(np.array([0, 60, 128, 200, 255], np.uint8), (4, 5))
    pixels = {"L": values, "I;16": values.astype(np.uint16) * 257, "F": np.float32(values / 255)}
    Image.fromarray(pixels[mode]).save(tmp_path / "a.tif", icc_profile=linear_light)
    right = 255 * (1.055 * (values / 255) ** (1 / 2.4) - 0.055).clip(0)
    assert np.abs(decode(tmp_path / "a.tif")[..., 1] - right).max() <= 2


@pytest.mark.parametrize("suffix", ["jpg", "tif"])
def test_inks_by_their_profile(tmp_path: Path, suffix: str) -> None:
    """A table of two values an ink: each is as dark as black, down to L* = 0."""
    light = 255 * (np.indices((2,) * 4).sum(axis=0) == 0)
    nodes = np.stack([light, np.full((2,) * 4, 128), np.full((2,) * 4, 128)], axis=-1)
    table = struct.pack(">4s4x4B9i", b"mft1", 4, 3, 2, 0, *(65536 * np.eye(3, dtype=int)).ravel())
    table += bytes(range(256)) * 4 + nodes.astype(np.uint8).tobytes() + bytes(range(256)) * 3
    white = struct.pack(">4s4x3i", b"XYZ ", 63190, 65536, 54061)
    tags = struct.pack(">I4sII4sII", 2, b"wtpt", 156, 20, b"A2B0", 176, len(table))
    head = struct.pack(">I4xI4s4s4s12x4s", 176 + len(table), 0x02400000, b"prtr", b"CMYK", b"Lab ",
                       b"acsp")  # fmt: skip
    icc = (head.ljust(68, b"\0") + white[8:]).ljust(128, b"\0") + tags + white + table
    inks = np.zeros((8, 40, 4), np.uint8)
    inks[..., 3] = np.repeat([0, 64, 128, 192, 255], 8)
    Image.fromarray(inks, "CMYK").save(tmp_path / f"a.{suffix}", icc_profile=icc, quality=100)
    lightness = 100 * (1 - np.array([0, 64, 128, 192, 255]) / 255)  # CIE 1976
    y = np.where(lightness > 8, ((lightness + 16) / 116) ** 3, lightness / 903.3)
    right = 255 * np.where(y > 0.0031308, 1.055 * y ** (1 / 2.4) - 0.055, 12.92 * y)
    found = decode(tmp_path / f"a.{suffix}")[4, 4::8].astype(float)
    assert np.abs(found - right[:, None]).max() <= 3


def test_lab_is_read_without_a_profile(tmp_path: Path) -> None:
    lab = ImageCms.buildTransform(
        ImageCms.createProfile("sRGB"), ImageCms.createProfile("LAB"), "RGB", "LAB"
    ).apply(stored())
    lab.save(tmp_path / "a.tif", icc_profile=b"")
    assert off_by(tmp_path / "a.tif") <= 8  # 8 bits of Lab are that coarse


def test_srgb_changes_no_byte(tmp_path: Path) -> None:
    """Profiles of sRGB differ by rounding."""
    noise = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    usual = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    ours = profile(SRGB, srgb_curve)
    for icc in (usual, ours):
        Image.fromarray(noise).save(tmp_path / "a.png", icc_profile=icc)
        assert np.array_equal(decode(tmp_path / "a.png"), noise)
        assert colours_in_words(tmp_path / "a.png") == ""


def test_damaged_profiles_are_said_and_the_photo_is_read(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    cmyk_of_grey = P3_PROFILE.replace(b"RGB XYZ ", b"CMYKXYZ ")
    damages = {"cut": P3_PROFILE[:200], "noise": noise.tobytes(), "cmyk": cmyk_of_grey}
    files = {f"{name}.png": tmp_path / f"{name}.png" for name in damages}
    for name, icc in damages.items():
        Image.fromarray(noise).save(files[f"{name}.png"], icc_profile=icc)
    files["packed.png"] = png(
        tmp_path / "packed.png", Image.fromarray(noise), (b"iCCP", b"p\0\0damaged")
    )
    files["p3.png"] = tmp_path / "p3.png"
    Image.fromarray(noise).save(files["p3.png"], icc_profile=P3_PROFILE)
    events: list[Event] = []
    found = read_contents(files, context=Context(emit=events.append))
    for name, path in files.items():
        assert found[name].whole and found[name].colours == (
            CONVERTED if name == "p3.png" else DAMAGED
        )
        assert np.array_equal(decode(path), noise) == (name != "p3.png")
    said = [event.text for event in events if isinstance(event, Message)]
    assert any(
        "4 photos with a colour profile that cannot be used, read as sRGB" in t for t in said
    )
    assert any(t.startswith("1 photo in another colour space than sRGB") for t in said)


def shared(size: int) -> bytes:
    """A profile with 60 more tags, which share nearly all of `size` bytes more."""
    (count,) = struct.unpack_from(">I", P3_PROFILE, 128)
    first, more = 132 + 12 * count, 60
    known = [struct.unpack_from(">4sII", P3_PROFILE, 132 + 12 * k) for k in range(count)]
    tags = [(name, start + 12 * more, length) for name, start, length in known]
    end = len(P3_PROFILE) + 12 * more + size
    tags += [(b"x%03d" % k, 128 + k, end - 128 - k) for k in range(more)]
    table = b"".join(struct.pack(">4sII", *tag) for tag in tags)
    made = P3_PROFILE[:128] + struct.pack(">I", len(tags)) + table
    return struct.pack(">I", end) + (made + P3_PROFILE[first:] + bytes(size))[4:]


def test_tags_of_a_profile_that_share_their_data_are_not_copied() -> None:
    """100 tags of 30 MB took 3 GB."""
    icc = shared(4 << 20)
    tracemalloc.start()
    space = space_of_profile(icc)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert space is not None and most < 16 << 20


def test_a_profile_of_many_megabytes_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    for size, said in ((1 << 20, CONVERTED), (9 << 20, DAMAGED)):
        stored().save(path, icc_profile=shared(size))
        assert colours_in_words(path) == said
