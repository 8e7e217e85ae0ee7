"""Photo sizes from file headers: what Pillow writes, in the kinds that photos come in."""

from __future__ import annotations

import io
import struct
import zlib
from contextlib import nullcontext
from pathlib import Path

import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from roigs_engine.photos import jpeg
from roigs_engine.photos.decode import check_whole
from roigs_engine.photos.exposures import exif_exposure
from roigs_engine.photos.headers import (
    MAX_PIXELS,
    PhotoError,
    check_complete,
    exif_of,
    open_photo,
    photo_size,
)
from tests.fuzz.inputs import jpeg_of_claimed_size, png_of_claimed_size


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"dpi": (72, 72), "comment": "a"}])
def test_jpeg(tmp_path: Path, options: dict[str, object]) -> None:
    exif = Image.Exif()
    exif[0x010F] = "maker" * 200
    path = tmp_path / "a.jpg"
    Image.new("RGB", (321, 123)).save(path, exif=exif, icc_profile=b"\xff\xd8" * 900, **options)
    assert photo_size(path) == (321, 123)


@pytest.mark.parametrize("suffix", ["png", "bmp", "tif", "webp", "ppm"])
def test_other_kinds(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    Image.new("RGB", (321, 123)).save(path)
    assert photo_size(path) == (321, 123)


@pytest.mark.parametrize("cut", [2, 3, 20, 160])
@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_cut_files(tmp_path: Path, suffix: str, cut: int) -> None:
    path = tmp_path / f"a.{suffix}"
    Image.new("RGB", (321, 123)).save(path)
    data = path.read_bytes()[: 20 if suffix == "png" else cut]
    path.write_bytes(data)
    with pytest.raises(PhotoError, match="a\\." + suffix):
        photo_size(path)


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_files_cut_in_their_pixels(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    Image.effect_noise((321, 123), 80).save(path)
    check_complete(path)
    data = path.read_bytes()
    path.write_bytes(data + b"\0" * 200_000)  # a telephone's film
    check_complete(path)
    path.write_bytes(data[: len(data) // 2])
    assert photo_size(path) == (321, 123)
    with pytest.raises(PhotoError, match="a\\." + suffix):
        check_complete(path)


@pytest.mark.parametrize("data", [b"\xff\xd8" + b"\xff" * 50, b"\xff\xd8\xff\xda\0\x02", b"hello"])
def test_no_photos(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.jpg").write_bytes(data)
    with pytest.raises(PhotoError):
        photo_size(tmp_path / "a.jpg")


@pytest.mark.parametrize("side", [0, 13_350, 65_500, 1 << 20, (1 << 31) - 1])
def test_photos_that_claim_to_be_larger_than_any(tmp_path: Path, side: int) -> None:
    """They are refused by their headers, before anything is made as large as they claim."""
    path = tmp_path / "a.png"
    path.write_bytes(png_of_claimed_size(side, side))
    if 0 < side * side <= MAX_PIXELS:
        assert photo_size(path) == (side, side)
        return
    with pytest.raises(PhotoError, match=f"{side} x {side} pixels"):
        photo_size(path)
    if side < 1 << 16:
        path.write_bytes(jpeg_of_claimed_size(side, side))
        with pytest.raises(PhotoError, match=f"{side} x {side} pixels"):
            photo_size(path)


@pytest.mark.parametrize("progressive", [True, False])
def test_a_jpeg_of_hundreds_of_scans_is_not_decoded(tmp_path: Path, progressive: bool) -> None:
    """Each scan takes the time of all pixels, however short it is."""
    path = tmp_path / "a.jpg"
    Image.effect_noise((64, 48), 80).convert("RGB").save(path, progressive=progressive)
    data = path.read_bytes()
    if not progressive:  # the scan of one channel of three
        at = data.index(b"\xff\xda")
        data = data[:at] + b"\xff\xda\0\x08\x01" + data[at + 5 : at + 7] + data[at + 11 :]
    last = data[data.rindex(b"\xff\xda") : -2]
    for count in (20, 300):
        path.write_bytes(data[:-2] + last * count + b"\xff\xd9" + b"\xff\xda" * 500)
        if count == 20:
            with open_photo(path):
                pass
            continue
        with pytest.raises(PhotoError, match=r"a\.jpg \(a JPEG of 3\d\d scans\)"), open_photo(path):
            pass


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I4s", len(data), kind) + data + struct.pack(">I", zlib.crc32(kind + data))


def rationals(count: int) -> bytes:
    """EXIF data with so many exposure times; the exposure itself is usual."""
    own = struct.pack("<H", 1) + struct.pack("<HHII", 0x8769, 4, 1, 26) + bytes(4)
    times = struct.pack("<HHII", 0x829A, 5, count, 56), struct.pack("<HHII", 0x8827, 3, 1, 100)
    below = struct.pack("<H", 2) + b"".join(times) + bytes(4)
    return b"II*\0\x08\0\0\0" + own + below + struct.pack("<II", 1, 60) * count


@pytest.mark.parametrize("before", [True, False])
def test_a_png_of_far_too_long_exif_data(tmp_path: Path, before: bool) -> None:
    """120 MB of them took 3 GB."""
    path, out = tmp_path / "a.png", io.BytesIO()
    Image.new("RGB", (9, 6)).save(out, "PNG")
    at = out.getvalue().index(b"IDAT" if before else b"IEND") - 4
    for count, good in ((1, True), (200_000, False)):
        data = chunk(b"eXIf", rationals(count))
        path.write_bytes(out.getvalue()[:at] + data + out.getvalue()[at:])
        assert (exif_exposure(path) is not None) == good
        with nullcontext() if good else pytest.raises(PhotoError, match=r"EXIF data have 1 MB"):
            check_whole(path)


def test_exif_data_of_far_too_many_numbers_are_not_read(tmp_path: Path) -> None:
    path, found = tmp_path / "a.webp", []
    for count in (1, 200_000):
        Image.new("RGB", (9, 6)).save(path, exif=b"Exif\0\0" + rationals(count))
        found.append(exif_exposure(path))
        check_whole(path)
    assert found[0] is not None and found[1] is None


def test_exif_data_in_the_text_of_a_png(tmp_path: Path) -> None:
    """Pillow would read them without our checks."""
    path = tmp_path / "a.png"
    shared = b"".join(struct.pack("<HHII", 40000 + k, 7, 1000, 8) for k in range(500))
    overlapping = b"II*\0\x08\0\0\0" + struct.pack("<H", 500) + shared + bytes(1000)
    for data, good in ((rationals(1), True), (overlapping, False), (b"", False)):
        text = PngInfo()
        text.add_text("Raw profile type exif", f"\nexif\n {len(data)}\n{data.hex()}")
        Image.new("RGB", (9, 6)).save(path, pnginfo=text)
        with open_photo(path) as photo:
            assert bool(exif_of(photo)) == good


@pytest.mark.parametrize("part", [b"\xff\xfe\0\2", b"\xff", b"\xff\xd0"])
def test_a_jpeg_of_far_too_many_segments(tmp_path: Path, part: bytes) -> None:
    """2 million empty comments took a minute."""
    path, out = tmp_path / "a.jpg", io.BytesIO()
    Image.new("RGB", (9, 6)).save(out, "JPEG")
    data = out.getvalue()
    for count in (1000, 2_000_000):
        path.write_bytes(data[:2] + part * count + data[2:])
        if count == 1000:
            assert photo_size(path) == (9, 6)
            check_whole(path)
            continue
        for read in (photo_size, check_complete, check_whole):
            with pytest.raises(PhotoError, match=r"a\.jpg \(a JPEG of more than 4,096 segments"):
                read(path)


def test_a_jpeg_of_far_too_long_exif_data(tmp_path: Path) -> None:
    """Pillow joins all segments."""
    path, out = tmp_path / "a.jpg", io.BytesIO()
    Image.new("RGB", (9, 6)).save(out, "JPEG")
    data, segment = out.getvalue(), b"\xff\xe1\xff\xff" + b"Exif\0\0".ljust(65_533)
    path.write_bytes(data[:2] + segment * 17 + data[2:])
    with pytest.raises(PhotoError, match="its EXIF data have more than 1 MB"):
        check_whole(path)


@pytest.mark.parametrize("parts", [1, 2])
def test_a_jpeg_of_exif_data_with_a_wrong_pointer(tmp_path: Path, parts: int) -> None:
    """Only programs of bad will write several segments of them."""
    path, out = tmp_path / "a.jpg", io.BytesIO()
    Image.new("RGB", (9, 6)).save(out, "JPEG")
    tags = struct.pack("<H", 1) + struct.pack("<HHII", 0x8769, 4, 1, 26) + bytes(4)
    exif = b"Exif\0\0II*\0\x08\0\0\0" + tags + b"\xff" * 60_000
    segment = b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif
    path.write_bytes(out.getvalue()[:2] + segment * parts + out.getvalue()[2:])
    with nullcontext() if parts == 1 else pytest.raises(PhotoError, match="65,535 tags"):
        check_whole(path)
    assert exif_exposure(path) is None


@pytest.mark.parametrize("late", [False, True])
def test_a_png_of_far_too_many_chunks(tmp_path: Path, late: bool) -> None:
    path, out = tmp_path / "a.png", io.BytesIO()
    Image.new("RGB", (9, 6)).save(out, "PNG")
    data = out.getvalue()
    at = data.index(b"IEND" if late else b"IDAT") - 4
    for count in (1000, 200_000):
        path.write_bytes(data[:at] + chunk(b"teXt", b"") * count + data[at:])
        with (
            nullcontext()
            if count == 1000
            else pytest.raises(PhotoError, match=r"a\.png \(a PNG of more than")
        ):
            check_whole(path)


@pytest.mark.parametrize("kind", ["jp2", "raw", "tiff"])
def test_a_jpeg_2000_of_tiny_tiles(tmp_path: Path, kind: str) -> None:
    """Each tile takes 12 kB of memory: 265 bytes took 800 MB."""
    if kind == "tiff":
        pytest.importorskip("imagecodecs")
    file = io.BytesIO()
    image = Image.new("RGB", (255, 255))
    image.save(file, "JPEG2000", no_jp2=kind != "jp2", quality_mode="rates")
    data = bytearray(file.getvalue())
    at = data.index(b"\xff\x4f\xff\x51") + 4
    path = tmp_path / ("a.tif" if kind == "tiff" else "a.jp2")
    for side in (16, 1):
        struct.pack_into(">II", data, at + 20, side, side)
        if kind == "tiff":
            path.write_bytes(tiff_of(bytes(data)))
        else:
            path.write_bytes(data)
        if side == 16 and kind != "tiff":
            with open_photo(path):
                pass
        if side == 1:
            with pytest.raises(PhotoError, match="65,025 tiles"), open_photo(path) as photo:
                photo.load()


def tiff_of(strip: bytes) -> bytes:
    """A TIFF of 255 x 255 RGB in one strip of JPEG 2000."""
    tags = (
        *((256, 4, 1, 255), (257, 4, 1, 255), (258, 3, 1, 8), (259, 3, 1, 34712)),
        *((262, 3, 1, 2), (273, 4, 1, 8), (277, 3, 1, 3), (278, 4, 1, 255)),
        (279, 4, 1, len(strip)),
    )
    strip += bytes(len(strip) % 2)
    head = struct.pack("<2sHI", b"II", 42, 8 + len(strip))
    rows = b"".join(struct.pack("<HHII", *tag) for tag in tags)
    return head + strip + struct.pack("<H", len(tags)) + rows + bytes(4)


def test_a_jpeg_far_longer_than_its_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not read whole: what follows its end does not count, and it must have one."""
    monkeypatch.setattr(jpeg, "BESIDE", 20_000)
    path = tmp_path / "a.jpg"
    Image.effect_noise((64, 48), 80).convert("RGB").save(path, progressive=True)
    data = path.read_bytes()
    path.write_bytes(data + bytes(10**6))
    with open_photo(path):
        pass
    path.write_bytes(data[:-2] + bytes(10**6))
    with pytest.raises(PhotoError, match=r"for 64 x 48 pixels"), open_photo(path):
        pass
