"""TIFF photos that Pillow does not read, or reads as other pictures, opened with tifffile.

Pillow reads 8 bits, 16 bits of chunky pixels, and floats of one channel; `pillow_reads` has the
exact rule. All else is read here: other planes, byte orders, numbers, and compressions, and files
whose first page is a small copy or a mask. As with Pillow, white is the largest value of the type,
1 for floats.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, TiffImagePlugin

from ..errors import EngineError

MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
# Tags (TIFF 6.0), and what they say.
SUBFILE, BITS, COMPRESSION, PHOTOMETRIC, PLANAR, EXTRA, FORMAT = 254, 258, 259, 262, 284, 338, 339
COLOURS, INKS, PROFILE = 320, 332, 34675
KEPT = (271, 272, 274)  # maker, model and orientation, as EXIF data have them
SMALL_OR_MASK = 1 | 4
MINISWHITE, MINISBLACK, RGB, PALETTE, CMYK, YCBCR, CIELAB, ICCLAB = 0, 1, 2, 3, 5, 6, 8, 9
ASSOCIATED, UNASSOCIATED = 1, 2
UNSIGNED, FLOAT = 1, 3
ZSTD, JPEG = 50000, (6, 7)
# None, CCITT, LZW, Deflate, PackBits, LZMA: what libtiff in Pillow reads.
COMPRESSIONS = {1, 2, 3, 4, 5, *JPEG, 8, 32773, 32946, 34925, ZSTD}
CHANNELS = {MINISWHITE: 1, MINISBLACK: 1, RGB: 3, PALETTE: 1, CMYK: 4, CIELAB: 3, ICCLAB: 3}
MODES = {RGB: "RGB", PALETTE: "RGB", CMYK: "CMYK", CIELAB: "LAB", ICCLAB: "LAB", YCBCR: "RGB"}
MOST_PAGES = 64
HINT = "Save it as a TIFF of 8 or 16 bits, grey or RGB, or as PNG."
Result = TypeVar("Result")


class UnsupportedError(ValueError):
    """A valid file that is not read; says what it is."""


def is_tiff(path: Path) -> bool:
    """Whether a file begins as a TIFF does; OSError if it cannot be read."""
    with open(path, "rb") as file:
        return file.read(4) in MAGIC


def pillow_reads(photo: Image.Image) -> bool:
    """Whether Pillow decodes an opened photo rightly; always so if it is no TIFF."""
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
    return chunky and tags.get(PHOTOMETRIC) != MINISWHITE


def _of_eight_bits(palette: Sequence[int]) -> bool:
    """Whether a palette has values of 8 bits, not of 16 as the format demands, as libtiff says."""
    return max(palette, default=256) < 256


def colmap_reads(photo: Image.Image) -> bool:
    """Whether pycolmap decodes an opened photo to the same picture; always so if it is no TIFF."""
    if not isinstance(photo, TiffImagePlugin.TiffImageFile):
        return not isinstance(photo, TiffPhoto)
    tags = photo.tag_v2
    associated = ASSOCIATED in tags.get(EXTRA, ())
    return tags.get(COMPRESSION) != ZSTD and not associated and photo.mode != "LAB"


class TiffPhoto(ImageFile.ImageFile):
    """A TIFF as Pillow opens photos: `mode` and `size` at once, pixels by `load`.

    Raises:
        EngineError: tifffile or imagecodecs is needed, and not installed.
        UnsupportedError: the file is valid, but of a kind that is not read.
    """

    format = "TIFF"

    def __init__(self, path: Path) -> None:
        """Raises as the class; on damaged files, tifffile raises many kinds of errors."""
        self._path = path
        self._loaded = False
        super().__init__(path)

    def _open(self) -> None:
        with _library(self._path).TiffFile(self._path) as file:
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
        """(H, W, 1 or 3) grey or RGB of more than 8 bits, 65,535 for white; None: it is another."""
        return self._read(_deep)

    def _read(self, read: Callable[[Any], Result]) -> Result:
        with _library(self._path).TiffFile(self._path) as file:
            try:
                return read(_photo_page(file))
            except ValueError as error:
                if "imagecodecs" in str(error):
                    raise _missing(self._path, "imagecodecs") from error
                raise


def _library(path: Path) -> Any:
    try:
        library = import_module("tifffile")
    except ImportError as error:
        raise _missing(path, "tifffile") from error
    logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)  # errors are raised as well
    return library


def _missing(path: Path, package: str) -> EngineError:
    return EngineError(
        f"Reading the TIFF {path} needs {package}, which is not installed.",
        f"Run: pip install tifffile imagecodecs (Blender: set up the engine again). {HINT}",
    )


def _photo_page(file: Any) -> Any:
    """The first page that is neither a small copy nor a mask; also one below the first."""
    pages = _pages(file)
    return next(
        (page for page in pages if not int(page.subfiletype) & SMALL_OR_MASK), file.pages[0]
    )


def _pages(file: Any) -> Iterator[Any]:
    """The pages of a file, those below the first one after it; of each kind, `MOST_PAGES`."""
    first = file.pages[0]
    yield first
    places = {offset: k for k, offset in reversed([*enumerate(first.subifds or ())])}
    below: Any = first.pages if places else None
    with suppress(IndexError):  # their number is known only once all are read
        for k in sorted(places.values())[:MOST_PAGES]:
            yield below[k]
    with suppress(IndexError):
        for k in range(1, MOST_PAGES):
            yield file.pages[k]


def _check(page: Any) -> None:
    """Raise UnsupportedError if a page is of a kind that is not read, ValueError: it is damaged."""
    photometric = int(page.photometric)
    end = page.parent.filehandle.size
    if any(o + n > end for o, n in zip(page.dataoffsets, page.databytecounts, strict=False)):
        raise ValueError("its data end before the photo does")
    channels = CHANNELS.get(photometric, 0)
    if photometric == YCBCR and int(page.compression) in JPEG:
        channels = 3
    kind = page.dtype.kind if page.dtype is not None else "none"
    known = channels and page.samplesperpixel >= channels and kind in "uifb"
    if not known or page.imagedepth != 1 or (photometric == CMYK and _other_inks(page)):
        name = getattr(page.photometric, "name", photometric)
        raise UnsupportedError(
            f"a TIFF of {page.samplesperpixel} channels, {page.bitspersample} bits, {name}"
        )


def _other_inks(page: Any) -> bool:
    """Whether a page's inks are not cyan, magenta, yellow and black."""
    return INKS in page.tags and int(page.tags[INKS].value) != 1


def _alpha(page: Any) -> int:
    """ASSOCIATED or UNASSOCIATED; 0: a page has no alpha."""
    extra = [int(value) for value in page.extrasamples[:1]]
    return extra[0] if extra and extra[0] in (ASSOCIATED, UNASSOCIATED) else 0


def _mode(page: Any) -> str:
    mode = MODES.get(int(page.photometric), "L")
    return {"L": "LA", "RGB": "RGBA"}.get(mode, mode) if _alpha(page) else mode


def _values(page: Any) -> NDArray[Any]:
    """(H, W, channels) the values of a page as they are stored."""
    values: NDArray[Any] = page.asarray()
    if page.axes.startswith("S"):  # planes
        values = np.moveaxis(values, 0, -1)
    return values.reshape(page.imagelength, page.imagewidth, -1)


def _decoded(page: Any) -> Image.Image:
    """The pixels of a page in 8 bits, with Pillow's mode for them."""
    photometric, mode = int(page.photometric), _mode(page)
    if photometric == PALETTE:
        colours = page.colormap.T[_values(page)[..., 0]]
        shift = 0 if _of_eight_bits(page.colormap.ravel().tolist()) else 8
        return Image.fromarray((colours >> shift).astype(np.uint8))
    if mode == "LAB":
        return _lab(_values(page)[..., :3], signed=photometric == CIELAB)
    size, rounded = (page.imagewidth, page.imagelength), _straight(page).round().astype(np.uint8)
    return Image.frombytes(mode, size, rounded.tobytes())


def _deep(page: Any) -> NDArray[np.uint16] | None:
    mode = _mode(page)
    eight = page.bitspersample <= 8 or int(page.photometric) == PALETTE
    if eight or mode not in ("L", "LA", "RGB", "RGBA"):
        return None
    colours = _straight(page)[..., : 1 if mode[0] == "L" else 3]
    return np.asarray((colours * 257).round().astype(np.uint16))


def _straight(page: Any) -> NDArray[np.float32]:
    """(H, W, channels of the mode) of a page, 0 to 255; colours are not multiplied by alpha."""
    scaled = _eight_bits(_values(page)[..., : Image.getmodebands(_mode(page))], page.bitspersample)
    if int(page.photometric) == MINISWHITE:
        scaled[..., 0] = 255 - scaled[..., 0]
    if _alpha(page) == ASSOCIATED:
        with np.errstate(divide="ignore", invalid="ignore"):
            straight = scaled[..., :-1] * (255 / scaled[..., -1:])
        scaled[..., :-1] = np.nan_to_num(straight, nan=0, posinf=0).clip(0, 255)
    return scaled


def _eight_bits(values: NDArray[Any], bits: int) -> NDArray[np.float32]:
    """Values of a type, or of fewer bits in it, as 0 to 255."""
    if values.dtype.kind == "b":
        most = 1.0
    elif values.dtype.kind == "f":
        most = 1.0
        values = np.nan_to_num(values, nan=0, posinf=1, neginf=0)
    else:
        most = 2.0 ** (bits - (values.dtype.kind == "i")) - 1
        # Programs write 16 bits as signed 32; by its type, such a photo would be black.
        if values.dtype == np.int32 and values.max(initial=0) <= 65535:
            most = 65535
    return (np.clip(values.astype(np.float32) / np.float32(most), 0, 1) * 255).astype(np.float32)


def _lab(values: NDArray[Any], *, signed: bool) -> Image.Image:
    """L*a*b* of 8 or 16 bits as Pillow's LAB, from bytes with signed a* and b*."""
    high = (values.view(np.uint16) >> 8 if values.dtype.itemsize == 2 else values).astype(np.uint8)
    if not signed:  # ICC's: an offset of 128
        high[..., 1:] ^= 128
    height, width = high.shape[:2]
    return Image.frombytes("LAB", (width, height), high.tobytes(), "raw", "LAB")
