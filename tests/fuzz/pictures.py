"""Cases of photos: TIFF of every kind, and colour profiles."""

from __future__ import annotations

import functools
import importlib.util
import io
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageCms

from roigs_engine.photos.profiles import PRIMARIES, srgb_curve
from tests.fuzz import inputs
from tests.fuzz.cases import MODEL, Case, good_photos, write_scene
from tests.fuzz.damage import ODD_INTEGERS, bytes_damaged
from tests.fuzz.scenes import looked_at
from tests.icc_profiles import P3, power_curve, profile

SLOPE = np.array(Image.open(io.BytesIO(inputs.photo())))
TYPES = ("u1", "u2", "u4", "i1", "i2", "i4", "f2", "f4", "f8")
COMPRESSIONS = (None, None, "lzw", "zlib", "packbits", "zstd", "lzma", "jpeg", "jpeg2000", "webp")
TAGS = (254, 256, 257, 258, 259, 262, 273, 277, 278, 279, 284, 317, 320, 322, 323, 324, 325, 330,
        338, 339, 700, 34665, 34675, 50000)  # fmt: skip
CHUNKS = (b"iCCP", b"cICP", b"cHRM", b"gAMA", b"sRGB", b"tRNS", b"eXIf", b"sBIT", b"PLTE")


def shown(dice: random.Random, folder: Path, photos: dict[str, bytes]) -> Case:
    """The command that decodes a scene in which these photos take the place of good ones."""
    names = dice.sample(inputs.NAMES, len(photos))
    files = good_photos() | dict(zip(names, photos.values(), strict=True))
    write_scene(folder / "in", inputs.binary_files(MODEL), files)
    if dice.random() < 0.3:
        photo = folder / "in" / "images" / dice.choice(names)
        return Case(["show-photo", str(photo), "--out", str(folder / "out" / "a.jpg")])
    command = ["decode", str(folder / "in")]
    return Case(command if dice.random() < 0.7 else looked_at(dice, folder))


def good_tiff(dice: random.Random) -> bytes:
    """A TIFF of some kind, perhaps with other pages around it."""
    import tifffile

    kind, compression = np.dtype(dice.choice(TYPES)), dice.choice(COMPRESSIONS)
    if compression in ("jpeg", "webp"):
        kind = np.dtype("u1")
    elif compression == "jpeg2000":
        kind = np.dtype(dice.choice(("u1", "u2")))
    most = 1 if kind.kind == "f" else np.iinfo(kind).max
    values = (SLOPE / 255 * most).astype(kind)
    options: dict[str, Any] = {"compression": compression, "photometric": "rgb"}
    if compression != "webp" and dice.random() < 0.3:
        values, options["photometric"] = values[..., 0], "minisblack"
        if kind.kind == "u" and compression != "jpeg" and dice.random() < 0.4:
            options["photometric"] = "miniswhite"
    elif dice.random() < 0.3 and compression not in ("jpeg", "webp", "jpeg2000"):
        values, options["planarconfig"] = values.transpose(2, 0, 1), "separate"
    if dice.random() < 0.3:
        options["tile"] = (16, 16)
    out = io.BytesIO()
    with tifffile.TiffWriter(out, bigtiff=dice.random() < 0.3, byteorder=dice.choice("<>")) as file:
        small = {"photometric": "minisblack", "subfiletype": 1}
        if dice.random() < 0.3:
            file.write(SLOPE[::4, ::4, 0], **small)
        below = dice.choice((0, 0, 2))
        file.write(values, **options, subifds=below or None)
        for _ in range(below):
            file.write(SLOPE[::2, ::2, 0], **small)
    return out.getvalue()


def tiff(dice: random.Random, folder: Path) -> Case:
    """TIFFs with other tags, tags that share data, pages in circles, and damaged as a whole."""
    data = bytearray(good_tiff(dice))
    order, large = "<" if data[:2] == b"II" else ">", 43 in data[2:4]
    place, number, entry = ("8xQ", "Q", "HHQQ") if large else ("4xI", "H", "HHII")
    (at,) = struct.unpack_from(order + place, data)
    (count,) = struct.unpack_from(order + number, data, at)
    first, size = at + struct.calcsize(number), struct.calcsize("<" + entry)
    row = first + size * dice.randrange(count)
    width = struct.calcsize("<Q" if large else "<I")
    most = 1 << 8 * width
    match dice.randrange(8):
        case 0:  # another number, type or tag
            offset = dice.choice((0, 2))
            values = TAGS if offset == 0 else range(20)
            struct.pack_into(order + "H", data, row + offset, dice.choice(values))
        case 1:  # another count, value or place
            at = row + 4 + dice.choice((0, width))
            values = (*ODD_INTEGERS, len(data), first, row)
            form = order + ("Q" if large else "I")
            struct.pack_into(form, data, at, dice.choice(values) % most)
        case 2:  # a page of its own, whose tags share their data
            shared = len(data)
            data += bytes(1 << 20)
            rows = bytes(data[first : first + count * size])
            code, kind, many = dice.choice(((50000, 7, 1 << 20), (273, 4, 1 << 18), (700, 1, 9)))
            more = dice.choice((1, 40, 3000))
            rows += struct.pack(order + entry, code, kind, many, shared) * more
            struct.pack_into(order + place[2:], data, struct.calcsize("<" + place[:2]), len(data))
            data += struct.pack(order + number, count + more) + rows + bytes(width)
        case 3:  # pages in a circle
            end = first + count * size
            struct.pack_into(order + place[2:], data, end, dice.choice((at, len(data), 8, 1)))
        case 4 | 5:
            data = bytearray(bytes_damaged(dice, bytes(data)))
        case 6:
            del data[dice.randrange(len(data)) :]
    return shown(dice, folder, {"a": bytes(data)})


@functools.cache
def profiles() -> tuple[bytes, ...]:
    """Good profiles: matrix and curves, Lab, grey."""
    made = [ImageCms.createProfile(kind) for kind in ("sRGB", "LAB", "XYZ")]
    ours = [profile(PRIMARIES[9][1], srgb_curve), profile(P3, power_curve(2.2))]
    grey = ours[1].replace(b"RGB XYZ ", b"GRAYXYZ ").replace(b"rTRC", b"kTRC")
    return (*(ImageCms.ImageCmsProfile(each).tobytes() for each in made), *ours, grey)


def damaged_profile(dice: random.Random) -> bytes:
    """A profile with other tags or curves, or damaged as a whole; now and then a good one."""
    data = bytearray(dice.choice(profiles()))
    match dice.randrange(6):
        case 0:
            at = 128 + 4 + 12 * dice.randrange(9) + dice.choice((0, 4, 8))
            struct.pack_into(">I", data, at, dice.choice(ODD_INTEGERS) % (1 << 32))
        case 1:
            at = data.find(dice.choice((b"curv", b"para", b"XYZ ")), 132)
            struct.pack_into(">I", data, max(at, 0) + 8, dice.choice(ODD_INTEGERS) % (1 << 32))
        case 2:
            data[16:20] = dice.choice((b"CMYK", b"GRAY", b"Lab ", b"RGB ", b"6CLR", b"\0\0\0\0"))
        case 3 | 4:
            data = bytearray(bytes_damaged(dice, bytes(data)))
    return bytes(data)


def png_with(dice: random.Random, icc: bytes) -> bytes:
    """A PNG of 8 or 16 bits with chunks of colours, some of them damaged."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    bits, kind = dice.choice((8, 16)), dice.choice((0, 2, 6))
    channels = {0: 1, 2: 3, 6: 4}[kind]
    values = np.dstack([SLOPE, SLOPE[..., :1]])[..., :channels]
    rows = [row.astype(">u2").tobytes() if bits == 16 else row.tobytes() for row in values]
    parts = [chunk(b"IHDR", struct.pack(">IIBBBBB", *SLOPE.shape[1::-1], bits, kind, 0, 0, 0))]
    for name in dice.sample(CHUNKS, dice.randint(1, 3)):
        body = {
            b"iCCP": b"p\0\0" + zlib.compress(icc),
            b"cICP": bytes(dice.choice((0, 1, 2, 9, 12, 16, 18, 255)) for _ in range(4)),
            b"cHRM": struct.pack(">8I", *(dice.choice((0, 1, 31270, 2**31)) for _ in range(8))),
            b"gAMA": struct.pack(">I", dice.choice((0, 1, 45455, 100000, 2**31, 2**32 - 1))),
        }.get(name, dice.randbytes(dice.choice((0, 1, 2, 6, 700))))
        parts.append(chunk(name, body if dice.random() < 0.7 else bytes_damaged(dice, body)))
    data = zlib.compress(b"".join(b"\0" + row for row in rows))
    return b"\x89PNG\r\n\x1a\n" + b"".join([*parts, chunk(b"IDAT", data), chunk(b"IEND", b"")])


def colours(dice: random.Random, folder: Path) -> Case:
    """Photos of all formats with damaged profiles, and PNGs with damaged chunks of colours."""
    photos = {}
    for number in range(dice.randint(1, 3)):
        icc = damaged_profile(dice)
        if dice.random() < 0.4:
            photos[str(number)] = png_with(dice, icc)
            continue
        out, form = io.BytesIO(), dice.choice(("JPEG", "PNG", "TIFF", "WEBP"))
        mode = dice.choice({"WEBP": ("RGB", "RGBA")}.get(form, ("RGB", "L")))
        if form in ("JPEG", "TIFF") and dice.random() < 0.3:
            mode = "CMYK"
        Image.fromarray(SLOPE).convert(mode).save(out, form, icc_profile=icc)
        data = out.getvalue()
        photos[str(number)] = data if dice.random() < 0.6 else bytes_damaged(dice, data)
    return shown(dice, folder, photos)


INSTALLED = all(importlib.util.find_spec(name) for name in ("tifffile", "imagecodecs"))

FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "colours": (colours, 400),
    **({"tiff": (tiff, 500)} if INSTALLED else {}),
}
