"""Opens TIFF photos that Pillow cannot read, or reads wrongly, with tifffile.

Pillow reads 8 bits, 16 bits of chunky pixels, and floats of one channel; `pillow_reads` has the
exact rule. All other files are read here: other planes, byte orders, types and compressions, and
files whose first page is a small copy or a mask. As with Pillow, white is the largest value of the
type, 1 for floats.
"""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, TiffImagePlugin

from ..formats.files import regular
from ..machine import package
from .jpeg import check_scans, jpeg_size
from .jpeg2000 import START, picture_of
from .png import png_chunks
from .profiles import parts_of
from .tiff_tags import MAGIC, MOST_PAGES

# Tags (TIFF 6.0), and their values.
SUBFILE, BITS, COMPRESSION, PHOTOMETRIC, PLANAR, EXTRA, FORMAT = 254, 258, 259, 262, 284, 338, 339
COLOURS, INKS, PROFILE = 320, 332, 34675
KEPT = (271, 272, 274)  # maker, model and orientation, as in EXIF data
SMALL_OR_MASK = 1 | 4
MINISWHITE, MINISBLACK, RGB, PALETTE, CMYK, YCBCR, CIELAB, ICCLAB = 0, 1, 2, 3, 5, 6, 8, 9
ASSOCIATED, UNASSOCIATED = 1, 2
UNSIGNED, FLOAT = 1, 3
ZSTD, JPEG = 50000, (6, 7)
# No compression, CCITT, LZW, Deflate, PackBits, LZMA: libtiff in Pillow reads these.
COMPRESSIONS = {1, 2, 3, 4, 5, *JPEG, 8, 32773, 32946, 34925, ZSTD}
CHANNELS = {MINISWHITE: 1, MINISBLACK: 1, RGB: 3, PALETTE: 1, CMYK: 4, CIELAB: 3, ICCLAB: 3}
MODES = {RGB: "RGB", PALETTE: "RGB", CMYK: "CMYK", CIELAB: "LAB", ICCLAB: "LAB", YCBCR: "RGB"}
MOST_SIDE = 4096  # pixels of a tile's side, unless the page is larger
MOST_BYTES = 1_450_000_000  # of a decoded page: 178 million pixels of 4 x 2 bytes
PADDING = 16  # pixels that a codec may add to a strip
JPEG_2000, WEBP, PNG = (33003, 33004, 33005, 34712), 50001, 34933
READ = COMPRESSIONS | {*JPEG_2000, WEBP, PNG}
HINT = "Save it as a TIFF of 8 or 16 bits, grey or RGB, or as PNG."
Result = TypeVar("Result")


class UnsupportedError(ValueError):
    """The file is valid, but its kind is not supported; the message names the kind."""


def is_tiff(path: Path) -> bool:
    """Whether a file begins like a TIFF; OSError if it cannot be read."""
    with open(path, "rb", opener=regular) as file:
        return file.read(4) in MAGIC


def pillow_reads(photo: Image.Image) -> bool:
    """Whether Pillow decodes an opened photo correctly; True if it is no TIFF."""
    if not isinstance(photo, TiffImagePlugin.TiffImageFile):
        return True
    tags = photo.tag_v2
    formats, compression = {*tags.get(FORMAT, (UNSIGNED,))}, tags.get(COMPRESSION, 1)
    if tags.get(SUBFILE, 0) & SMALL_OR_MASK or compression not in COMPRESSIONS:
        return False
    if photo.mode in ("P", "PA") and _of_eight_bits(tags.get(COLOURS, ())):
        return False
    if photo.mode == "La" or not formats <= {UNSIGNED, FLOAT}:
        return False
    chunky, associated = tags.get(PLANAR, 1) == 1, ASSOCIATED in tags.get(EXTRA, ())
    if max(tags.get(BITS, (1,))) <= 8:
        return chunky or not associated
    if formats == {FLOAT} and tags.prefix == b"MM" and compression != 1:
        return False
    return chunky and not associated and tags.get(PHOTOMETRIC) != MINISWHITE


def _of_eight_bits(palette: Sequence[int]) -> bool:
    """Whether a palette has 8-bit values instead of the format's 16 bits (libtiff's rule)."""
    return max(palette, default=256) < 256


def colmap_reads(photo: Image.Image) -> bool:
    """Whether pycolmap decodes an opened photo to the same picture; True if it is no TIFF."""
    if not isinstance(photo, TiffImagePlugin.TiffImageFile):
        return not isinstance(photo, TiffPhoto)
    tags = photo.tag_v2
    associated = ASSOCIATED in tags.get(EXTRA, ())
    return tags.get(COMPRESSION) != ZSTD and not associated and photo.mode != "LAB"


class TiffPhoto(ImageFile.ImageFile):
    """A TIFF with Pillow's interface: `mode` and `size` at once, pixels by `load`.

    Raises:
        EngineError: tifffile or imagecodecs is needed, but not installed.
        UnsupportedError: the file is valid, but its kind is not supported.
    """

    format = "TIFF"

    def __init__(self, path: Path) -> None:
        """Raises as the class; on damaged files, tifffile raises many kinds of errors."""
        self._path = path
        self._loaded = False
        super().__init__(path)

    def _open(self) -> None:
        with _package("tifffile", self._path).TiffFile(self._path) as file:
            page = _photo_page(file)
            _check(page)
            self._size = (page.imagewidth, page.imagelength)
            self._mode = _mode(page)
            self.info["bits"] = page.bitspersample
            if PROFILE in page.tags:
                self.info["icc_profile"] = bytes(page.tags[PROFILE].value)
            exif = Image.Exif()
            for tag in KEPT:
                if tag in page.tags:
                    exif[tag] = page.tags[tag].value
            self.info["exif"] = exif.tobytes()
        self.tile = []

    def load(self) -> Any:
        """Decode the pixels, once."""
        if not self._loaded:
            self.im = self._read(_decoded).im
            self._loaded = True
        return Image.Image.load(self)

    def deep(self) -> NDArray[np.uint16] | None:
        """(H, W, 1 or 3) grey or RGB of more than 8 bits, white 65,535; None for other kinds."""

        def read(page: Any) -> NDArray[np.uint16] | None:
            mode = _mode(page)
            eight = page.bitspersample <= 8 or int(page.photometric) == PALETTE
            if eight or mode not in ("L", "LA", "RGB", "RGBA"):
                return None
            channels = 1 if mode[0] == "L" else 3
            return np.asarray(_straight(page, np.uint16, 257)[..., :channels])

        return self._read(read)

    def _read(self, read: Callable[[Any], Result]) -> Result:
        with _package("tifffile", self._path).TiffFile(self._path) as file:
            try:
                return read(_photo_page(file))
            except ValueError as error:
                if "imagecodecs" in str(error):
                    _package("imagecodecs", self._path)
                raise


def _package(name: str, path: Path) -> Any:
    library = package(name, f"Reading the TIFF {path}", otherwise=HINT)
    logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)  # it raises errors anyway
    return library


def _photo_page(file: Any) -> Any:
    """The first page that is neither a small copy nor a mask, including those below the first."""
    pages = _pages(file)
    return next(
        (page for page in pages if not int(page.subfiletype) & SMALL_OR_MASK), file.pages[0]
    )


def _pages(file: Any) -> Iterator[Any]:
    """Yield the first page, the pages below it, and the others; at most `MOST_PAGES` of each."""
    first = file.pages[0]
    yield first
    places = {offset: k for k, offset in reversed([*enumerate(first.subifds or ())])}
    below: Any = first.pages if places else None
    with suppress(IndexError):  # their number is unknown until all are read
        for k in sorted(places.values())[:MOST_PAGES]:
            yield below[k]
    with suppress(IndexError):
        for k in range(1, MOST_PAGES):
            yield file.pages[k]


def _check(page: Any) -> None:
    """Raise UnsupportedError if a page's kind is not supported, ValueError if it is damaged."""
    photometric = int(page.photometric)
    end = page.parent.filehandle.size
    places = [*zip(page.dataoffsets, page.databytecounts, strict=False)]
    if any(offset + count > end for offset, count in places):
        raise ValueError("its data end before the photo does")
    size, header = (page.imagewidth, page.imagelength), getattr(page, "jpegheader", None) or b""
    tile = (page.tilewidth, page.tilelength) if page.is_tiled else None
    piece, samples = tile or _strip(*size, page.rowsperstrip), page.samplesperpixel
    _check_memory(size, piece, samples, page.bitspersample)
    if page.compression not in READ:
        raise UnsupportedError(f"a TIFF with the compression {page.compression!r:.40}")
    _check_codec(page.parent.filehandle, places, piece, int(page.compression), samples, header)
    channels = CHANNELS.get(photometric, 0)
    if photometric == YCBCR and int(page.compression) in JPEG:
        channels = 3
    kind = page.dtype.kind if page.dtype is not None else "none"
    known = channels and page.samplesperpixel >= channels and kind in "uifb"
    other_inks = photometric == CMYK and INKS in page.tags and int(page.tags[INKS].value) != 1
    if not known or page.imagedepth != 1 or other_inks:
        name = getattr(page.photometric, "name", photometric)
        raise UnsupportedError(
            f"a TIFF of {page.samplesperpixel} channels, {page.bitspersample} bits, {name}"
        )


def check_parts(photo: Image.Image) -> None:
    """Raise as `_check` if decoding a photo that Pillow has opened would take far too long."""
    if not isinstance(photo, TiffImagePlugin.TiffImageFile):
        return
    tags = photo.tag_v2
    size, samples, tiled = (tags[256], tags[257]), tags.get(277, 1), 322 in tags
    piece = (tags[322], tags[323]) if tiled else _strip(*size, tags.get(278, 0))
    _check_memory(size, piece, samples, max(tags.get(BITS, (1,))))
    if tags.get(COMPRESSION) == 7 and photo.fp is not None:
        offsets, counts = (324, 325) if tiled else (273, 279)
        places = zip(tags[offsets], tags[counts], strict=False)
        _check_codec(photo.fp, places, piece, 7, samples)


def _strip(width: int, height: int, rows: int) -> tuple[int, int]:
    """Width and height of the strips of a page; `rows` = 0: there is one strip."""
    return width, min(rows or height, height)


def _check_memory(size: tuple[int, int], piece: tuple[int, int], samples: int, bits: int) -> None:
    """Raise UnsupportedError if a page or a tile would take far more memory than a photo."""
    if any(b > max(a + MOST_SIDE // 4, MOST_SIDE) for a, b in zip(size, piece, strict=True)):
        raise UnsupportedError(f"a TIFF of tiles of {piece[0]} x {piece[1]} pixels")
    for width, height in (size, piece):
        if width * height * samples * max(8, bits) // 8 > MOST_BYTES:
            text = f"a TIFF of {width} x {height} pixels, {samples} channels, {bits} bits"
            raise UnsupportedError(text)


def _check_codec(
    file: Any,
    places: Iterable[tuple[int, int]],
    piece: tuple[int, int],
    compression: int,
    samples: int,
    header: bytes = b"",
) -> None:
    """Raise ValueError if the picture in a strip or tile is larger than the strip or tile.

    Args:
        file, places: an open file; offsets and lengths of strips or tiles in it.
        piece: width and height of the largest.
        header: data that all of them share.
    """
    if compression not in (*JPEG, *JPEG_2000, WEBP, PNG):
        return
    distinct = [(offset, count) for offset, count in dict.fromkeys(places) if count]
    at, total = file.tell(), file.seek(0, io.SEEK_END)
    if sum(count for _, count in distinct) > total:
        raise ValueError("its strips overlap")
    for offset, count in distinct:
        file.seek(offset)
        inner = io.BytesIO(header + file.read(count))
        width, height = _own_size(inner, compression, samples)
        if width > piece[0] + PADDING or height > piece[1] + PADDING:
            raise ValueError(f"a part of {piece} pixels says that it has {width} x {height}")
    file.seek(at)


def _own_size(inner: BinaryIO, compression: int, samples: int) -> tuple[int, int]:
    """Width and height in a strip's header; for JPEG 2000, the largest (15444-1, A.5.1)."""
    if compression in JPEG:
        check_scans(inner)
        return jpeg_size(inner)
    if compression == PNG:
        for _ in png_chunks(inner):
            pass
        inner.seek(0)
    if compression not in JPEG_2000:
        with Image.open(inner, formats=("WEBP", "PNG")) as picture:
            return picture.size
    data, largest = inner.read(), (0, 0)
    for found in re.finditer(START, data):
        width, height, count = picture_of(data, found.end())
        if count > samples:
            raise ValueError(f"a part has {count} channels, not {samples}")
        largest = max(largest[0], width), max(largest[1], height)
    return largest


def _alpha(page: Any) -> int:
    """ASSOCIATED or UNASSOCIATED; 0: a page has no alpha."""
    extra = [int(value) for value in page.extrasamples[:1]]
    return extra[0] if extra and extra[0] in (ASSOCIATED, UNASSOCIATED) else 0


def _mode(page: Any) -> str:
    mode = MODES.get(int(page.photometric), "L")
    return {"L": "LA", "RGB": "RGBA"}.get(mode, mode) if _alpha(page) else mode


def _values(page: Any) -> NDArray[Any]:
    """(H, W, channels) stored values of a page."""
    values: NDArray[Any] = page.asarray()
    if page.axes.startswith("S"):  # separate planes
        values = np.moveaxis(values, 0, -1)
    return values.reshape(page.imagelength, page.imagewidth, -1)


def _decoded(page: Any) -> Image.Image:
    """Decode a page to 8 bits, in Pillow's mode for it."""
    photometric, mode = int(page.photometric), _mode(page)
    if photometric == PALETTE:
        colours = page.colormap.T[_values(page)[..., 0]]
        shift = 0 if _of_eight_bits(page.colormap.ravel().tolist()) else 8
        return Image.fromarray((colours >> shift).astype(np.uint8))
    if mode == "LAB":
        return _lab(_values(page)[..., :3], signed=photometric == CIELAB)
    rounded = _straight(page, np.uint8, 1)
    return Image.frombytes(mode, (page.imagewidth, page.imagelength), rounded.tobytes())


def _straight(page: Any, kind: type[np.unsignedinteger[Any]], factor: int) -> NDArray[Any]:
    """(H, W, channels of the mode) of a page, 0 to 255 * `factor`, alpha not premultiplied."""
    values = _values(page)[..., : Image.getmodebands(_mode(page))]
    white = np.float32(_white(values, page.bitspersample))
    result = np.empty(values.shape, kind)
    for part, made in zip(parts_of(values), parts_of(result), strict=True):
        if part.dtype.kind == "f":
            part = np.nan_to_num(part, nan=0, posinf=1, neginf=0)
        with np.errstate(over="ignore"):  # float64 beyond float32's range is white
            scaled = np.clip(part.astype(np.float32) / white, 0, 1) * np.float32(255)
        if int(page.photometric) == MINISWHITE:
            scaled[..., 0] = 255 - scaled[..., 0]
        if _alpha(page) == ASSOCIATED:
            with np.errstate(divide="ignore", invalid="ignore"):
                straight = scaled[..., :-1] * (255 / scaled[..., -1:])
            scaled[..., :-1] = np.nan_to_num(straight, nan=0, posinf=0).clip(0, 255)
        made[:] = (scaled * np.float32(factor)).round()
    return result


def _white(values: NDArray[Any], bits: int) -> float:
    """The value of white in a page: the largest one of its bits."""
    if values.dtype.kind in "bf":
        return 1.0
    # Some programs write 16-bit values as signed 32-bit ones. In that range, they would be black.
    if values.dtype == np.int32 and values.max(initial=0) <= 65535:
        return 65535.0
    return float(2.0 ** (bits - (values.dtype.kind == "i")) - 1)


def _lab(values: NDArray[Any], *, signed: bool) -> Image.Image:
    """Convert L*a*b* of 8 or 16 bits to Pillow's LAB, from bytes with signed a* and b*."""
    high = (values.view(np.uint16) >> 8 if values.dtype.itemsize == 2 else values).astype(np.uint8)
    if not signed:  # ICC's encoding has an offset of 128
        high[..., 1:] ^= 128
    height, width = high.shape[:2]
    return Image.frombytes("LAB", (width, height), high.tobytes(), "raw", "LAB")
