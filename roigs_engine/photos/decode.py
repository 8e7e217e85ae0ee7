"""Decodes photos to uint8 sRGB arrays at their camera's size, and detects damaged files.

All photos are decoded here, so that all are converted to sRGB (`colours`). Orientation tags are
ignored, as in COLMAP: pixels keep the file's order, unless a `turn` is given.

To find damage, a photo is decoded once, at a reduced size if that is cheaper. Pillow reports
truncated files, bytes that are no image data, and damaged PNG data. It does not report a JPEG whose
data end too early: libjpeg then fills the rest of the photo with one colour. `_ends_early` finds
this. In progressive JPEGs, it finds only a cut first scan, because later scans add only detail.
Damage that changes only colours in a JPEG, such as a single flipped bit, is not found, because the
format has no checksum.
"""

from __future__ import annotations

import io
import itertools
import math
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile

from ..formats.files import regular
from ..model.scene import PosedImage
from .colours import Colours, colours_of, deep_to_srgb, kind_of, packing, to_srgb
from .exposures import levelled
from .headers import PhotoError, check_unchanged, open_photo, open_png
from .jpeg import jpeg_segments
from .profiles import PART, Deep
from .rotation import AS_STORED, turned, turned_size
from .tiff import TiffPhoto

Pixels = NDArray[np.uint8]
Counted = Callable[[], NDArray[np.bool_]]
Weights = NDArray[np.bool_] | NDArray[np.float32] | NDArray[np.uint8]
Box = tuple[float, float, float, float]
Change = Callable[[Image.Image], Image.Image]

# A JPEG is decoded at a fraction of its size if that is at least this multiple of the target size.
GAP = 2.0
EVEN = 1e-4  # tolerance of a sum of weights that are all 1
# Least sum of weights for a pixel to be weighted: with a mask, with an alpha channel.
LEAST_COUNTED, LEAST_SEEN = 0.35, 0.02
LANCZOS = 3  # reach of the filter, in pixels of the coarser of the two pictures
TILE = 64  # pixels of a side
BLACK, WHITE = "black", "white"
# Packings of 16 bits, and the same with the other byte order.
COLOUR = re.compile(r"(RGB|RGBA|RGBX);16([BLN])$")
OTHER = {"B": "L", "L": "B", "N": "B" if sys.byteorder == "little" else "L"}
# Of 255. Values of 14 bits in a 16-bit file end at 63; correct photos are brighter.
BRIGHTEST_BLACK, MEAN_WHITE = 63, 250


def decode(
    path: Path,
    size: tuple[int, int] | None = None,
    turn: int = AS_STORED,
    counted: Counted | None = None,
) -> Pixels:
    """Decode a photo to (H, W, 3) uint8 sRGB, resampled to `size` = (width, height) if given.

    Grey, palette, CMYK, 16-bit and float files are converted; an alpha channel is dropped. White is
    the largest value of the file's type, 1 for floats. It does not depend on the photo's values:
    otherwise a dark photo would become brighter than the others of its scene.

    Args:
        turn: how the stored pixels are turned (`rotation`); `size` is the size after it.
        counted: makes the mask after the turn; called if the photo is resampled. Resampling then
            ignores the colours of ignored pixels. Without it, the alpha channel weights pixels.

    Raises:
        PhotoError: the file is missing or cannot be decoded.
    """
    if counted is not None and size is not None:
        pixels = decode(path, turn=turn)  # decoding at reduced size would mix colours
        return pixels if pixels.shape[1::-1] == size else _resized(pixels, size, counted())
    if turn != AS_STORED:
        return turned(decode(path, size and turned_size(size, turn)), turn)
    with open_photo(path) as photo:
        full = photo.size
        if size is not None:
            photo.draft("RGB", (round(size[0] * GAP), round(size[1] * GAP)))
        # Draft mode reduces a JPEG by 1, 2, 4 or 8.
        shrink = next((n for n in (1, 2, 4, 8) if -(-full[0] // n) == photo.width), 1)
        colours = colours_of(photo)
        picture, colours = _decoded(photo, colours)
        alpha = opacity(photo) if size not in (None, picture.size) else None
    del photo  # its pixels may take as much memory as the picture
    if alpha is not None and alpha.min() < 255 and size is not None:
        return _resized(np.asarray(to_srgb(picture, colours)), size, alpha, LEAST_SEEN)
    if size is not None and picture.size != size:
        # The last column and row of a draft may extend past the photo: exclude that part.
        box = (0.0, 0.0, full[0] / shrink, full[1] / shrink)
        picture = picture.resize(size, Image.Resampling.LANCZOS, box=box)
    # Last, because it takes several times as long as decoding.
    return np.array(to_srgb(picture, colours), dtype=np.uint8)


def opacity(photo: Image.Image) -> Pixels | None:
    """The alpha channel (H, W) of an opened photo; None: it has none."""
    if not photo.has_transparency_data:
        return None
    clear = _transparent(photo)
    if clear is not None:
        return np.where(clear, np.uint8(0), np.uint8(255))
    whole = photo if photo.mode in ("LA", "RGBA") else photo.convert("RGBA")
    return np.asarray(whole.getchannel("A"))


def _resized(
    pixels: Pixels, size: tuple[int, int], weights: Weights, least: float = LEAST_COUNTED
) -> Pixels:
    """Resample to `size` as `weighted`; only tiles with different weights take time.

    Weights of 8 bits are 255 times as large.
    """
    result = np.array(Image.fromarray(pixels).resize(size, Image.Resampling.LANCZOS))
    scale = pixels.shape[1] / size[0], pixels.shape[0] / size[1]
    for top, left in itertools.product(range(0, size[1], TILE), range(0, size[0], TILE)):
        tile = result[top : top + TILE, left : left + TILE]
        # The source pixels of the tile, and the pixels around them that the filter reaches.
        start = [side * k for side, k in zip((left, top), scale, strict=True)]
        end = [a + k * n for a, k, n in zip(start, scale, tile.shape[1::-1], strict=True)]
        reach = [math.ceil(LANCZOS * max(k, 1)) + 1 for k in scale]
        x, y = (max(0, int(a) - n) for a, n in zip(start, reach, strict=True))
        across, down = (math.ceil(b) + n for b, n in zip(end, reach, strict=True))
        given = weights[y:down, x:across]
        if given.dtype == np.uint8:
            given = np.divide(given, 255, dtype=np.float32)
        if (given.all() and given.min() == 1) or not given.any():
            continue
        box = (start[0] - x, start[1] - y, end[0] - x, end[1] - y)

        def change(picture: Image.Image, tile: Pixels = tile, box: Box = box) -> Image.Image:
            box = (*box[:2], min(box[2], picture.width), min(box[3], picture.height))
            return picture.resize((tile.shape[1], tile.shape[0]), Image.Resampling.LANCZOS, box)

        _weigh(tile, pixels[y:down, x:across], given, change, least)
    return result


def weighted(pixels: Pixels, weights: Weights, change: Change) -> Pixels:
    """Resample a picture (H, W, 3) linearly, with a weight for each pixel.

    A filter reaches some pixels beyond the pixel that it computes. Ignoring all results that reach
    an ignored pixel would cost a rim of three pixels around each mask. Instead, ignored pixels have
    the weight 0.

    Args:
        weights: (H, W), 0 to 1.
        change: resamples a picture of 8 bits, or of floats.
    """
    result = np.array(change(Image.fromarray(pixels)))
    _weigh(result, pixels, weights, change, LEAST_COUNTED)
    return result


def _weigh(result: Pixels, pixels: Pixels, weights: Weights, change: Change, least: float) -> None:
    """Apply weights, in place, to a picture `result` that was resampled without them.

    Pixels do not change if all their sources have the weight 1, or if their weights add up to less
    than `least`.
    """
    share = weights.astype(np.float32)
    total = np.asarray(change(Image.fromarray(share)))
    mixed = (np.abs(total - 1) > EVEN) & (total > least)
    if mixed.any():
        for channel in range(pixels.shape[2]):
            values = np.asarray(change(Image.fromarray(pixels[..., channel] * share)))
            result[mixed, channel] = (values[mixed] / total[mixed]).round().clip(0, 255)


def load_photo(image: PosedImage) -> Pixels:
    """Load a posed photo at its camera's size, levelled to its scene's exposure.

    Returns (H, W, 3) uint8 sRGB. If the photo has a `whole_size`, each pixel is the average of the
    pixels that it covers at that size. A damaged file that the engine made is recreated.

    Raises:
        PhotoError, MaskError: a file is missing, cannot be decoded, or was changed.
        RunFolderError: a file of the engine cannot be recreated.
    """
    return levelled(load_as_taken(image), image.exposure)


def load_as_taken(image: PosedImage) -> Pixels:
    """Load a posed photo as `load_photo`, but with its own exposure."""
    size = (image.camera.width, image.camera.height)
    if image.whole_size is None:
        return _load(image, size)
    n = max(2, round(image.pixel_size))
    return averaged(_load(image, (n * size[0], n * size[1])), n)


def averaged(pixels: Pixels, n: int) -> Pixels:
    """(n H, n W, 3) -> (H, W, 3) uint8, the means of squares of `n` x `n` pixels."""
    height, width, channels = pixels.shape
    squares = pixels.reshape(height // n, n, width // n, n, channels)
    return np.asarray(squares.mean(axis=(1, 3), dtype=np.float32).round().astype(np.uint8))


def _load(image: PosedImage, size: tuple[int, int]) -> Pixels:
    if image.remake is None:  # otherwise, the engine wrote the file
        check_unchanged(image.path, image.file_digest)
    counted = image.mask.whole if image.mask else None
    try:
        return decode(image.path, size, image.turn, counted)
    except PhotoError:
        if image.remake is None:
            raise
    image.remake()
    return decode(image.path, size, image.turn, counted)


def to_rgb(photo: Image.Image) -> Image.Image:
    """Decode the photo to 8-bit sRGB; on damaged files Pillow raises many kinds of errors."""
    colours = colours_of(photo)
    return to_srgb(*_decoded(photo, colours))


def _decoded(photo: Image.Image, colours: Colours) -> tuple[Image.Image, Colours]:
    """Decode the photo to 8 bits, as RGB or a mode that `to_srgb` converts; with its colours."""
    kind = kind_of(photo)  # before decoding
    deep = deep_values(photo) if colours.profile else None
    if deep is not None:
        converted = deep_to_srgb(deep, colours)
        if converted is not None:
            return converted, Colours()
        eight = ((deep.astype(np.uint32) + 128) // 257).astype(np.uint8)
        return Image.fromarray(eight[..., 0] if kind == "L" else eight), colours
    if photo.mode == "F":
        values = np.nan_to_num(np.array(photo), copy=False)  # only one copy of a large photo
        np.multiply(values.clip(0, 1, out=values), 255, out=values)
        pixels = Image.fromarray(values.round(out=values).astype(np.uint8))
    elif photo.mode.startswith("I"):  # "I" also holds 16 bits
        grey = deep_values(photo)
        assert grey is not None
        pixels = Image.fromarray((grey[..., 0] >> 8).astype(np.uint8))
    elif photo.mode in ("P", "PA"):
        pixels = photo.convert("RGBA")
    else:
        photo.load()  # no second copy of a large photo
        pixels = photo
    modes = ("L", "RGB", "CMYK", "LAB") if colours.profile else ("RGB",)
    if pixels.mode in modes:
        return pixels, colours
    stays_grey = colours.profile and pixels.mode in ("1", "LA")
    return pixels.convert("L" if stays_grey else "RGB"), colours


def _transparent(photo: Image.Image) -> NDArray[np.bool_] | None:
    """(H, W) where an opened PNG has its transparent colour; None: it has no such colour.

    Pillow compares tRNS with values scaled to 8 bits, but tRNS is not scaled.
    """
    colour = photo.info.get("transparency")
    if photo.format != "PNG" or photo.mode == "P" or isinstance(colour, bytes) or colour is None:
        return None
    with open_png(Path(getattr(photo, "filename", ""))) as fresh:  # not decoded yet
        stored = packing(fresh)
        values: NDArray[Any] | None = deep_values(fresh)
        if values is None:
            values = np.atleast_3d(np.asarray(fresh.convert("L") if fresh.mode == "1" else fresh))
    if photo.mode == "1":
        colour = 255 if colour else 0
    elif photo.mode == "L" and (bits := re.search(r"L;(\d)", stored)):
        colour = colour * (255 // (2 ** int(bits[1]) - 1))
    return np.asarray((values == np.array(colour)).all(axis=2))


def deep_values(photo: Image.Image) -> Deep | None:
    """(H, W, 1 or 3) uint16 grey or RGB of an opened photo that is not decoded yet.

    None: it has 8 bits, inks or L*a*b*, or the library does not provide its full depth.
    """
    if isinstance(photo, TiffPhoto):
        return photo.deep()
    stored = packing(photo)
    if photo.mode == "F":
        values = np.nan_to_num(np.array(photo), copy=False).clip(0, 1)
        return np.asarray((values * 65535).round().astype(np.uint16)[..., None])
    if photo.mode.startswith("I"):
        values = np.asarray(photo)
        if re.search(r"I;32[BN]?\b", stored):  # unsigned; signed types contain only 16 bits
            values = values.view(np.uint32) >> 16
        elif "I;12" in stored:
            values = values.astype(np.uint32) * 65535 // 4095
        return np.asarray(values.clip(0, 65535).astype(np.uint16)[..., None])
    first = stored.split(" ", 1)[0]
    if first == "LA;16B":  # two bytes each of grey and alpha
        with open_photo(Path(getattr(photo, "filename", ""))) as again:  # not turned by its tag
            _read_as(again, "RGBA")
            high, low = (np.asarray(again.getchannel(k)) for k in (0, 1))
        return np.asarray(high.astype(np.uint16) << 8 | low)[..., None]
    found = COLOUR.match(first)
    if found is None:
        return None
    channels, order = found.groups()
    colours: Deep = np.empty(0, np.uint16)
    # In parts, because the result has twice the bytes of Pillow's picture.
    for shift, half in ((8, order), (0, OTHER[order])):
        with open_photo(Path(getattr(photo, "filename", ""))) as again:
            _read_as(again, f"{channels};16{half}")
            if shift:
                colours = np.zeros((again.height, again.width, 3), np.uint16)
            rows = max(1, PART // again.width)
            for top in range(0, again.height, rows):
                box = (0, top, again.width, min(top + rows, again.height))
                part = np.asarray(again.crop(box))[..., :3]
                colours[top : top + rows] |= np.left_shift(part, shift, dtype=np.uint16)
    return colours


def _read_as(photo: Image.Image, packed: str) -> None:
    """Decode an opened photo, interpreting its bytes as another packing of as many bits."""
    assert isinstance(photo, ImageFile.ImageFile)
    photo.tile = [_packed(tile, packed) for tile in photo.tile]
    photo.load()


def _packed(tile: Any, packed: str) -> Any:
    args = (packed, *tile[3][1:]) if isinstance(tile[3], tuple) else packed
    return tile._replace(args=args) if hasattr(tile, "_replace") else (*tile[:3], args)  # Pillow 10


def tone_if_deep(photo: Image.Image) -> str:
    """BLACK or WHITE if a photo of more than 8 bits a channel decodes to nearly that, else "".

    Its values then probably do not match their type: 12 bits in a file of 16, or floats up to 255.
    Decodes the photo, which must be freshly opened; raises as `to_rgb`.
    """
    deep = photo.mode[0] in "IF" or ";16" in packing(photo) or photo.info.get("bits", 8) > 8
    rgb = to_rgb(photo)
    if not deep:
        return ""
    pixels = np.asarray(rgb)
    if pixels.max(initial=0) <= BRIGHTEST_BLACK:
        return BLACK
    return WHITE if pixels.mean() > MEAN_WHITE else ""


NOISE = np.random.default_rng(0).integers(1, 255, 1 << 15, dtype=np.uint8).tobytes()
END = b"\xff\xd9"
RESTART_INTERVAL, RESTARTS = 0xDD, range(0xD0, 0xD8)  # JPEG markers: in the headers; in the data


def check_whole(path: Path) -> str:
    """Decode the photo; PhotoError if the file is incomplete. Returns its `tone_if_deep`."""
    with open_photo(path) as photo:
        kind = photo.format
        if kind == "PNG":
            photo.verify()  # checks the checksums of all chunks; decoding checks only the pixels'
    with open_photo(path) as photo:
        if kind not in ("JPEG", "MPO"):
            return tone_if_deep(photo)
        with open(path, "rb", opener=regular) as file:
            last = _eighth(file)[-1:, -2:]
            # If libjpeg filled in missing data, the last pixels have one colour.
            if (last == last[:, -1:]).all() and _ends_early(file):
                raise ValueError("its data end before the photo does")
    return ""  # a JPEG has 8 bits a channel


def _eighth(file: BinaryIO) -> Pixels:
    """A JPEG at an eighth of its size, which takes a sixth of the time."""
    with Image.open(file, formats=("JPEG",)) as photo:
        photo.draft("RGB", (max(1, photo.width // 8), max(1, photo.height // 8)))
        return np.asarray(photo.convert("RGB"))


def _ends_early(file: BinaryIO) -> bool:
    """Whether a JPEG's data end before the photo does.

    Noise is appended to the data. It changes the photo only if the data are incomplete; otherwise
    decoding ends before the noise.
    """
    end = _end_of_first_scan(file)
    file.seek(0)
    data = file.read(end)
    before, after = (_eighth(io.BytesIO(data + noise + END)) for noise in (b"", NOISE))
    return not np.array_equal(before, after)


def _end_of_first_scan(file: BinaryIO) -> int:
    """The end of a JPEG's first image data: the first marker that cannot be within them."""
    file.seek(0)
    restarts = RESTART_INTERVAL in list(jpeg_segments(file))
    at = file.tell()
    file.seek(0)
    data = file.read()
    while 0 <= at < len(data) - 1:
        marker = data[at + 1]
        if data[at] == 0xFF and marker and not (restarts and marker in RESTARTS):
            return at
        at = data.find(b"\xff", at + 1)
    return len(data)
