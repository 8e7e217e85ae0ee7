"""The family of TIFF: every kind of numbers, planes, byte orders and compressions."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageCms

from roigs_engine.context import QUIET
from roigs_engine.errors import EngineError
from roigs_engine.photos import tiff_tags
from roigs_engine.photos.contents import read_contents
from roigs_engine.photos.decode import BLACK, check_whole, decode
from roigs_engine.photos.headers import PhotoError, exif_of, open_photo, photo_size
from roigs_engine.photos.mask_images import alpha_mask, has_alpha
from roigs_engine.reconstruction.convert import converted
from roigs_engine.reconstruction.folder import Folder
from tests.waiting import at_most

tifffile = pytest.importorskip("tifffile")
pytest.importorskip("imagecodecs")

Y, X = np.mgrid[:24, :32]
COLOUR = np.stack([X * 8, Y * 10, X + 2 * Y], axis=-1).astype(np.uint8)
GREY = COLOUR[..., 0]
ALPHA = np.where(X < 16, 255, 128).astype(np.uint8)
TYPES = ("u1", "u2", "u4", "i1", "i2", "i4", "f2", "f4", "f8")


def of_type(values: np.ndarray, kind: str) -> np.ndarray:
    """Values of 8 bits over the whole range of a type."""
    dtype = np.dtype(kind)
    if dtype.kind == "f":
        return (values / 255).astype(dtype)
    most = np.iinfo(dtype).max
    return (values.astype(np.float64) / 255 * most).round().clip(0, most).astype(dtype)


def kinds() -> Iterator[tuple[str, np.ndarray, np.ndarray, dict[str, Any]]]:
    """Name, the right picture, what is written, and how."""
    rgb, planes = {"photometric": "rgb"}, {"photometric": "rgb", "planarconfig": "separate"}
    for kind in TYPES:
        colour, grey = of_type(COLOUR, kind), of_type(GREY, kind)
        white_is_zero = of_type(255 - GREY, kind)
        for order in "<>":
            end = {"byteorder": order}
            yield f"grey {kind}{order}", GREY, grey, {"photometric": "minisblack", **end}
            yield f"colour {kind}{order}", COLOUR, colour, {**rgb, **end}
            yield f"planes {kind}{order}", COLOUR, colour.transpose(2, 0, 1), {**planes, **end}
            if kind[0] == "u":
                zero = {"photometric": "miniswhite", **end}
                yield f"white is zero {kind}{order}", GREY, white_is_zero, zero
    for compression in ("lzw", "zlib", "packbits", "zstd", "lzma"):
        for kind, order in (("u1", "<"), ("u2", ">"), ("f4", ">")):
            how = {"compression": compression, "byteorder": order}
            how |= {} if compression == "packbits" else {"predictor": True}
            yield f"{compression} {kind}", COLOUR, of_type(COLOUR, kind), {**rgb, **how}
            yield f"{compression} grey {kind}", GREY, of_type(GREY, kind), how
    for kind in ("u1", "u2"):
        colour = of_type(COLOUR, kind)
        inks = of_type(np.dstack([255 - COLOUR, 0 * GREY]), kind)
        cmyk = {"photometric": "separated"}
        yield f"tiles {kind}", COLOUR, colour, {**rgb, "tile": (16, 16)}
        yield (
            f"tiles of planes {kind}",
            COLOUR,
            colour.transpose(2, 0, 1),
            planes | {"tile": (16, 16)},
        )
        yield f"big {kind}", COLOUR, colour, {**rgb, "bigtiff": True}
        yield f"inks {kind}", COLOUR, inks, cmyk
        yield f"planes of inks {kind}", COLOUR, inks.transpose(2, 0, 1), cmyk | planes | cmyk
        for extra in ("unassalpha", "unspecified", "assocalpha"):
            weight = ALPHA / 255 if extra == "assocalpha" else np.ones_like(ALPHA)
            four = of_type(np.dstack([(COLOUR * weight[..., None]).round(), ALPHA]), kind)
            two = of_type(np.dstack([(GREY * weight).round(), ALPHA]), kind)
            options = {"extrasamples": [extra]}
            yield f"colour {extra} {kind}", COLOUR, four, {**rgb, **options}
            yield f"grey {extra} {kind}", GREY, two, {"photometric": "minisblack", **options}
            yield f"planes {extra} {kind}", COLOUR, four.transpose(2, 0, 1), planes | options
    palette = np.stack([np.arange(256), np.arange(255, -1, -1), np.arange(256)]).astype(np.uint16)
    mirrored = np.stack([GREY, 255 - GREY, GREY], axis=-1)
    yield "palette", mirrored, GREY, {"photometric": "palette", "colormap": palette * 257}
    eight = {"photometric": "palette", "colormap": palette}  # not of 16 bits, as it must be
    yield "palette of 8 bits", mirrored, GREY, eight
    deep = np.stack([np.arange(65536)] * 3).astype(np.uint16)
    yield "palette of 65,536", GREY, of_type(GREY, "u2"), {**eight, "colormap": deep}
    bits = GREY > 127
    yield "one bit", bits * np.uint8(255), bits, {"photometric": "minisblack"}
    yield "one bit, white is zero", bits * np.uint8(255), ~bits, {"photometric": "miniswhite"}


def test_every_kind_is_decoded_to_the_pixels_that_were_written(tmp_path: Path) -> None:
    wrong = {}
    for number, (name, right, values, how) in enumerate(kinds()):
        path = tmp_path / f"{number}.tif"
        tifffile.imwrite(path, np.ascontiguousarray(values), **how)
        wanted = right if right.ndim == 3 else np.repeat(right[..., None], 3, axis=2)
        try:
            assert photo_size(path) == (32, 24)
            off = np.abs(decode(path).astype(int) - wanted).max()
        except (EngineError, AssertionError) as error:
            wrong[name] = str(error)
            continue
        if off > 2:
            wrong[name] = str(off)
    assert not wrong


def test_pycolmap_gets_the_same_pixels(tmp_path: Path) -> None:
    """Files that it reads differently become JPEG."""
    pycolmap = pytest.importorskip("pycolmap")
    (tmp_path / "photos").mkdir()
    wanted = {}
    for number, (name, right, values, how) in enumerate(kinds()):
        tifffile.imwrite(tmp_path / f"photos/{number}.tif", np.ascontiguousarray(values), **how)
        wanted[f"{number}.tif"] = name, right
    folder = Folder(tmp_path / "scene")
    folder.work().mkdir(parents=True)
    files = converted(folder.photos_of(tmp_path / "photos"), folder, QUIET)
    assert len(files) == len(wanted) and sum(name.endswith(".jpg") for name in files) > 20
    wrong = {}
    for name, path in files.items():
        kind, right = wanted[name.removesuffix(".jpg")]
        pixels = np.asarray(pycolmap.Bitmap.read(str(path), as_rgb=True).to_array()).astype(int)
        if np.abs(pixels - (right if right.ndim == 3 else right[..., None])).mean() > 2:
            wrong[kind] = pixels
    assert not wrong


@pytest.mark.parametrize("first", ["small", "mask"])
def test_a_small_copy_or_a_mask_before_the_photo(tmp_path: Path, first: str) -> None:
    for below in (None, 1):
        path = tmp_path / f"{below}.tif"
        with tifffile.TiffWriter(path) as file:
            if first == "small":
                file.write(COLOUR[::4, ::4], photometric="rgb", subfiletype=1, subifds=below)
            else:
                file.write(GREY > 99, photometric="minisblack", subfiletype=4, subifds=below)
            file.write(COLOUR, photometric="rgb")
            if below is None:
                file.write(255 - COLOUR, photometric="rgb")
        assert photo_size(path) == (32, 24)
        assert np.array_equal(decode(path), COLOUR)


def test_alpha_orientation_and_profile_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    icc = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    four = of_type(np.dstack([COLOUR, np.where(X < 16, 255, 99)]), "u2").transpose(2, 0, 1)
    tags = [(274, "H", 1, 6, True), (34675, "B", len(icc), icc, True)]
    how = {"planarconfig": "separate", "extrasamples": ["unassalpha"], "extratags": tags}
    tifffile.imwrite(path, np.ascontiguousarray(four), photometric="rgb", **how)
    assert has_alpha(path) and np.array_equal(alpha_mask(path), X < 16)
    assert np.abs(decode(path).astype(int) - COLOUR).max() <= 1
    assert np.array_equal(decode(path, turn=6)[:, -1], decode(path)[0])


def test_lab_of_16_bits(tmp_path: Path) -> None:
    lab = np.empty((4, 4, 3), np.uint16)
    lab[:] = round(0.536 * 65535), 0, 0  # L* 53.6: the middle of sRGB
    tifffile.imwrite(tmp_path / "a.tif", lab, photometric="cielab")
    assert np.abs(decode(tmp_path / "a.tif").astype(int) - 128).max() <= 2


def test_signed_32_bits_that_hold_16(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", GREY.astype(np.int32) * 257)
    assert np.abs(decode(tmp_path / "a.tif")[..., 1].astype(int) - GREY).max() <= 1


def test_dark_photos_of_planes_are_named_too(tmp_path: Path) -> None:
    dark = (COLOUR.astype(np.uint16) * 16).transpose(2, 0, 1)  # 12 bits in 16
    tifffile.imwrite(tmp_path / "a.tif", dark, photometric="rgb", planarconfig="separate")
    assert check_whole(tmp_path / "a.tif") == BLACK


@pytest.mark.parametrize("damage", ["cut", "compressed", "header"])
def test_damaged_files_are_named(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "photo 7.tif"
    noise = np.random.default_rng(0).integers(0, 65536, (3, 24, 32), dtype=np.uint16)
    how = {"compression": "lzw"} if damage == "compressed" else {}
    tifffile.imwrite(path, noise, photometric="rgb", planarconfig="separate", **how)
    data = path.read_bytes()
    if damage == "compressed":
        path.write_bytes(data[:-2500] + b"\xff" * 2500)
    else:
        path.write_bytes(data[: -1000 if damage == "cut" else 40])
    with pytest.raises(PhotoError, match=r"photo 7\.tif"):
        check_whole(path)
    assert read_contents({"a": path})["a"].whole is False


def test_what_is_not_a_picture_is_called_not_supported(tmp_path: Path) -> None:
    path = tmp_path / "raw.tif"
    tifffile.imwrite(path, of_type(GREY, "u2"), photometric="cfa")
    with pytest.raises(PhotoError, match="not supported: a TIFF of 1 channels, 16 bits, CFA"):
        decode(path)


@pytest.mark.parametrize("package", ["tifffile", "imagecodecs"])
def test_a_missing_package_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    """The photo is not remembered as damaged; ordinary ones are read without it."""
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, of_type(COLOUR, "f4"), photometric="rgb", compression="lzw")
    Image.fromarray(COLOUR).save(tmp_path / "b.tif")
    if package == "imagecodecs":

        def asarray(page: Any) -> None:
            raise ValueError("<COMPRESSION.LZW: 5> requires the 'imagecodecs' package")

        monkeypatch.setattr(tifffile.TiffPage, "asarray", asarray)
    monkeypatch.setitem(sys.modules, package, None)
    assert np.array_equal(decode(tmp_path / "b.tif"), COLOUR)
    with pytest.raises(EngineError, match=f"needs {package}") as caught:
        read_contents({"a": path})
    assert not isinstance(caught.value, PhotoError) and "pip install" in caught.value.hint


@pytest.mark.parametrize("kind", ["below", "after"])
def test_only_so_many_pages_are_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """A file may name one page any number of times, or hold any number of small ones."""
    path = tmp_path / "a.tif"
    small = {"subfiletype": 1, "photometric": "minisblack"}
    with tifffile.TiffWriter(path) as file:
        if kind == "below":
            file.write(of_type(GREY, "i2"), **small, subifds=1000)
        for _ in range(1000):
            file.write(of_type(GREY[:2, :2], "i2"), **small)
    made = []
    first = tifffile.TiffPage.__init__

    def counting(page: Any, *args: Any, **options: Any) -> None:
        made.append(page)
        first(page, *args, **options)

    monkeypatch.setattr(tifffile.TiffPage, "__init__", counting)
    decode(path)
    assert len(made) < 200


@pytest.mark.parametrize("kind", ["u1", "i2"])
def test_a_tile_much_larger_than_the_photo_is_not_supported(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, of_type(GREY, kind), tile=(64, 64), compression="zlib")
    assert decode(path).shape == (24, 32, 3)
    with tifffile.TiffFile(path, mode="r+") as file:
        for name in ("TileWidth", "TileLength"):
            file.pages[0].tags[name].overwrite(16000)
    with pytest.raises(PhotoError, match="not supported: a TIFF of tiles of 16000 x 16000 pixels"):
        decode(path)


@pytest.mark.parametrize("codec", ["jpeg", "jpeg2000", "webp", "png", "lerc"])
def test_a_strip_that_says_that_it_is_larger_is_not_decoded(tmp_path: Path, codec: str) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, COLOUR, photometric="rgb", compression=codec)
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        if codec == "lerc":
            with pytest.raises(PhotoError, match="not supported: a TIFF with the compression"):
                decode(path)
            return
        assert np.abs(decode(path).astype(int) - COLOUR).mean() < 9
        lines = page.tags["ImageLength"].valueoffset, page.tags["RowsPerStrip"].valueoffset
    data = bytearray(path.read_bytes())
    for at in lines:  # the photo has fewer than its strip
        data[at : at + 2] = (4).to_bytes(2, sys.byteorder)
    path.write_bytes(data)
    with pytest.raises(PhotoError, match=r"a\.tif"):
        decode(path)


def with_tags(path: Path, codes: list[int], kind: int, count: int, *, big: bool) -> None:
    """A TIFF of 16-bit planes with tags of a type, which all have the same data."""
    planes = of_type(COLOUR, "u2").transpose(2, 0, 1)
    options = {"photometric": "rgb", "planarconfig": "separate", "byteorder": "<"}
    tifffile.imwrite(path, planes, bigtiff=big, **options)
    data = path.read_bytes()
    head, number, entry = (16, "<Q", "<HHQQ") if big else (8, "<H", "<HHII")
    (at,) = struct.unpack_from("<8xQ" if big else "<4xI", data)
    (before,) = struct.unpack_from(number, data, at)
    start = at + struct.calcsize(number)
    rows = data[start : start + before * struct.calcsize(entry)]
    shared = len(data)
    data += bytes(1 << 20)
    rows += b"".join(struct.pack(entry, code, kind, count, shared) for code in codes)
    where = struct.pack("<Q" if big else "<I", len(data))
    page = struct.pack(number, before + len(codes)) + rows + bytes(8)
    path.write_bytes(data[: head - len(where)] + where + data[head:] + page)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(
    ("codes", "kind", "count", "said"),
    [
        ([273] * 40, 4, 1 << 18, "the data of its tags overlap"),
        ([*range(50000, 50040)], 7, 1 << 20, "the data of its tags overlap"),
        ([*range(40000, 44097)], 3, 1, r"a page has 4,\d+ tags"),
    ],
)
def test_tags_that_share_their_data_are_not_read(
    tmp_path: Path, codes: list[int], kind: int, count: int, said: str, big: bool
) -> None:
    """Each was read, and kept: a file of 100 MB took hundreds of GB."""
    path = tmp_path / "a.tif"
    with_tags(path, codes[:2], kind, 1 if count == 1 else count // 4, big=big)
    assert np.array_equal(decode(path), COLOUR)
    with_tags(path, codes, kind, count, big=big)
    with pytest.raises(PhotoError, match=said):
        decode(path)


@pytest.mark.parametrize(("code", "kind", "width"), [(282, 5, 8), (273, 5, 8), (40000, 3, 2)])
def test_tags_of_far_too_many_numbers(tmp_path: Path, code: int, kind: int, width: int) -> None:
    """3 million resolutions took Pillow 25 seconds."""
    path = tmp_path / "a.tif"
    with_tags(path, [code], kind, 1000, big=False)
    decode(path)
    data = bytearray(path.read_bytes())
    count = tiff_tags.MOST_NUMBERS + 1
    at = data.rindex(struct.pack("<HHI", code, kind, 1000))
    struct.pack_into("<II", data, at + 4, count, len(data))
    path.write_bytes(data + struct.pack("<II", 3, 7)[:width] * count)
    with pytest.raises(PhotoError, match="its tags have far too many numbers"):
        decode(path)


def test_lists_of_far_too_many_strips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiff_tags, "MOST_PLACES", 1000)
    with_tags(tmp_path / "a.tif", [324], 4, 1001, big=False)
    with pytest.raises(PhotoError, match="its pixels are in far too many parts"):
        decode(tmp_path / "a.tif")


@pytest.mark.parametrize("suffix", [".png", ".webp"])
def test_exif_data_whose_tags_overlap_are_not_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    tags = b"".join(struct.pack("<HHII", 40000 + k, 7, 1000, 8) for k in range(500))
    exif = b"Exif\0\0II*\0\x08\0\0\0" + struct.pack("<H", 500) + tags + bytes(1000)
    Image.fromarray(COLOUR).save(path, exif=exif, lossless=True)
    with open_photo(path) as photo:
        assert len(exif_of(photo)) == 0
    assert np.array_equal(decode(path), COLOUR)


def pages_of_pages(count: int, apart: int) -> bytes:
    """TIFF data with so many lists of tags, `apart` in bytes; each names the first ones of them."""
    own = b"".join(struct.pack("<HHII", 330, 4, 1, 8 + apart * k) for k in range(count))
    listed = struct.pack("<H", count) + own + struct.pack("<I", 0)
    return b"II*\0" + struct.pack("<I", 8) + listed + bytes(apart * count)


@pytest.mark.parametrize("apart", [0, 12])
@pytest.mark.parametrize("suffix", [".tif", ".jpg"])
def test_pages_below_that_name_one_another_end_soon(
    tmp_path: Path, suffix: str, apart: int
) -> None:
    """1,000 lists of tags that each name all of them: a million looks, each at 1,000 tags."""
    data, path = pages_of_pages(1000, apart), tmp_path / f"a{suffix}"
    if suffix == ".tif":
        path.write_bytes(data)
    else:
        Image.fromarray(COLOUR).save(path, exif=b"Exif\0\0" + data)
    late = MemoryError("it goes on")  # others become a PhotoError
    with at_most(8, late), suppress(PhotoError), open_photo(path) as photo:
        photo.load()


def test_floats_of_gigabytes_are_not_supported(tmp_path: Path) -> None:
    """A strip may be repeated: 17 kB became 2.4 GB, before the file was called damaged."""
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, of_type(COLOUR, "f4"), photometric="rgb", compression="zlib")
    with tifffile.TiffFile(path, mode="r+") as file:
        for name in ("ImageWidth", "ImageLength"):
            file.pages[0].tags[name].overwrite(13_000)
    with pytest.raises(PhotoError, match="not supported: a TIFF of 13000 x 13000 pixels"):
        decode(path)


@pytest.mark.filterwarnings("error")
def test_floats_out_of_any_range_are_black_or_white(tmp_path: Path) -> None:
    values = np.tile([1e300, -1e300, np.nan, np.inf], (24, 8))
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="minisblack")
    assert decode(tmp_path / "a.tif")[0, :4, 0].tolist() == [255, 0, 0, 255]
