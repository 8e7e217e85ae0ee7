"""Niantic's SPZ: version 3 (gzip) is written through the package gsply, and 1 to 4 are read.

Positions are fixed-point numbers with 24 bits, so their resolution follows from the model's size.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..formats.drawable import FLAT
from ..formats.files import read_bytes, regular, write_bytes
from ..formats.ply_rows import Check, nothing
from ..machine import package
from ..model.scene import Float64
from .arrays import Arrays, Float32, in_morton_order, logits, unit_quats
from .libraries import NotSupportedError, refuse_bomb, scratch

TITLE = "SPZ"
MAGIC, GZIP = 0x5053474E, b"\x1f\x8b"
BITS = 24  # of a coordinate, with its sign
MOST_FRACTION = 20  # bits behind the point
SMALL, FINER = 0.05, 4  # a step is at most 2^-FINER of the size at this quantile
FARTHEST = 1000.0  # most distance of a Gaussian from the origin, in median distances
SCALES = (-10.0, 5.9375)  # least and largest logarithm that the format stores
LOST = 0.01  # share of Gaussians whose size may change, or that may be left out
STEPS = (4 / 128, 6 / 128, 8 / 128, 10 / 128)
"""Of SH above degree 0; its own encoder has 16 / 128 above degree 1: 3 dB less than the last."""
PART = 8.1  # the finest step is used with which a PLY is at least so many times as large
BLOCKS, BLOCK = 8, 4096  # blocks of rows, and rows of one, from which the file's size is estimated
SH_ROWS = {0: 0, 1: 3, 2: 8, 3: 15, 4: 24}
COLOUR = np.float32(0.15)  # a byte of colour is this much of the SH coefficient of degree 0
LATEST = 4
MOST = 50_000_000  # Gaussians
FLAGS, ANTIALIASED, EXTENDED = 14, 0x1, 0x2
"""Byte of the header with flags, in all versions; those of anti-aliased Gaussians, extensions."""
COORDINATES = 0xADBE0003
"""Type of the record SPZ_ADOBE_coordinate_system, whose payload is a number."""
SYSTEMS = (
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)
"""Where x, y and z point, from number 1 on: left, right, down, up, back or front."""
MOST_RECORDS = 1 << 20  # bytes of extensions
HEAD = 1 << 16  # bytes of a file that hold its header, packed or not


def write(
    path: Path,
    arrays: Arrays,
    *,
    step: float | None = None,  # of SH above degree 0; None: the finest for a small file (`PART`)
    antialiased: bool = False,
    check: Check = nothing,
) -> int:
    """See `FileFormat`. Gaussians that are too far from the origin are left out."""
    data, count = encoded(arrays, step, antialiased=antialiased, check=check)
    write_bytes(path, data)
    return count


def encoded(
    arrays: Arrays,
    step: float | None = None,
    *,
    antialiased: bool = False,
    check: Check = nothing,
) -> tuple[bytes, int]:
    """Return a file's bytes, and its number of Gaussians; the arguments are those of `write`."""
    arrays = in_morton_order(arrays)
    scales = arrays["log_scales"]
    # Points without any size do not count: they would have none at any scale of the model.
    small = (scales < SCALES[0]).all(axis=1) & (scales > FLAT / 2).any(axis=1)
    outside = small | (scales > SCALES[1]).any(axis=1)
    if outside.mean() > LOST:
        raise ConfigError(
            "The Gaussians are too small or too large for SPZ.",
            "Scale the model to a size of a few units, or use another format.",
        )
    reach = np.abs(arrays["means"].astype(np.float32)).max(axis=1)
    farthest = max(1e-6, min(float(reach.max()), FARTHEST * float(np.median(reach))))
    free = BITS - 2 - np.floor(np.log2(farthest))
    fraction = int(np.clip(free, 1, _enough(scales.astype(np.float32))))
    inside = reach < 2.0 ** (BITS - 1 - fraction)
    if inside.mean() < 1 - LOST:
        raise ConfigError(
            "The model is too large, or too far from the origin, for SPZ.",
            "Scale the model to a size of a few units, or use another format.",
        )
    kept = {name: values[inside] for name, values in arrays.items()}
    step = step or _finest(kept, fraction, check)
    check()
    data = _packed(kept, fraction, step, antialiased=antialiased)
    check()
    return data, int(inside.sum())


def _packed(arrays: Arrays, fraction: int, step: float, *, antialiased: bool = False) -> bytes:
    """Return the file of Gaussians with `fraction` bits behind the point and `step` of SH."""
    gsply: Any = package("gsply", TITLE)
    spz: Any = package("gsply.spz", TITLE)
    sh = arrays["sh"].astype(np.float32)
    sh[:, 1:] = np.round(sh[:, 1:] / step) * step  # this compresses better
    data = gsply.GSData.from_arrays(
        means=arrays["means"].astype(np.float32),
        scales=arrays["log_scales"].astype(np.float32),
        quats=unit_quats(arrays),
        opacities=arrays["logit_opacities"].astype(np.float32),
        sh0=np.ascontiguousarray(sh[:, 0]),
        shN=np.ascontiguousarray(sh[:, 1:]),
    )
    with scratch(TITLE) as folder:
        made = folder / "model.spz"
        spz.write_spz(made, data, version=3, fractional_bits=fraction)
        whole = bytearray(gzip.decompress(made.read_bytes()))
    whole[FLAGS] |= ANTIALIASED if antialiased else 0  # gsply sets no flags
    # gsply's own compression is fast, but its files are a tenth larger.
    return gzip.compress(whole, 6, mtime=0)


def _finest(arrays: Arrays, fraction: int, check: Check) -> float:
    """Return the finest step of SH with a small file (`PART`), by a sample of the Gaussians."""
    count, bands = arrays["sh"].shape[:2]
    if bands == 1:
        return STEPS[-1]
    starts = np.linspace(0, max(count - BLOCK, 0), BLOCKS).astype(int)
    rows = np.unique(np.add.outer(starts, np.arange(BLOCK)))
    rows = rows[rows < count]
    sample = {name: values[rows] for name, values in arrays.items()}
    most = len(rows) * 4 * (14 + 3 * bands) / PART
    for step in STEPS[:-1]:
        check()
        if len(_packed(sample, fraction, step)) <= most:
            return step
    return STEPS[-1]


def _enough(log_scales: Float32) -> int:
    """Return the number of bits behind the point with which small Gaussians move invisibly."""
    small = np.quantile(log_scales.mean(axis=1), SMALL) / np.log(2)
    return int(np.clip(np.ceil(FINER - small), 1, MOST_FRACTION))


def read(path: Path) -> Arrays:
    """See `FileFormat`. The Gaussians stay in the file's coordinate system, whichever it names."""
    return unpacked(read_bytes(path, most=None))[0]


def frame(path: Path) -> Float64:
    """Return (3, 3) from a file's axes to right, up and back, the default axes of SPZ."""
    with open(path, "rb", opener=regular) as file:
        if not _flags(file.read(HEAD)) & EXTENDED:
            return np.eye(3)
    return unpacked(read_bytes(path, most=None))[1]


def is_antialiased(path: Path) -> bool:
    """Whether a file's header records that its Gaussians are drawn with anti-aliasing."""
    with open(path, "rb", opener=regular) as file:
        return bool(_flags(file.read(HEAD)) & ANTIALIASED)


def _flags(head: bytes) -> int:
    if head[:2] == GZIP:
        head = zlib.decompressobj(wbits=31).decompress(head, FLAGS + 1)
    return head[FLAGS]


def unpacked(raw: bytes) -> tuple[Arrays, Float64]:
    """Return the Gaussians of a file's bytes, in its own axes, and (3, 3) as in `frame`.

    This follows the description of the format in Niantic's spz, versions 1 to 4; SH of degree 4 is
    cut to 3. Any error but NotSupportedError means damage.
    """
    gzipped = raw[:2] == GZIP
    unpacker = zlib.decompressobj(wbits=31)
    head = unpacker.decompress(raw, 16) if gzipped else raw[:16]
    magic, version, count, degree, fraction, flags, streams = struct.unpack("<IIIBBBB", head)
    if magic != MAGIC or version < 1:
        raise ValueError("its header is not that of SPZ")
    if version > LATEST:
        raise NotSupportedError(f"version {version} of SPZ")
    if gzipped is (version == LATEST) or degree not in SH_ROWS or fraction > BITS:
        raise ValueError("its header is not that of SPZ")
    if count > MOST:
        raise ValueError(f"{count} Gaussians")
    # Positions, opacities, colours, sizes, rotations, SH
    widths = (6 if version == 1 else 9, 1, 3, 3, 3 if version < 3 else 4, 3 * SH_ROWS[degree])
    sizes = [count * width for width in widths]
    refuse_bomb(len(raw), sum(sizes))
    if gzipped:
        data, extensions = _gunzipped(unpacker, sum(sizes), extended=bool(flags & EXTENDED))
    else:
        data, extensions = _zstd(raw, streams, sizes)
    parts = np.split(np.frombuffer(data, np.uint8), np.cumsum(sizes)[:-1])
    means, alphas, colours, scales, quats, higher = (
        part.reshape(count, width) for part, width in zip(parts, widths, strict=True)
    )
    base = (colours[:, None].astype(np.float32) / 255 - 0.5) / COLOUR
    rest = higher.reshape(count, SH_ROWS[degree], 3)[:, : SH_ROWS[3]].astype(np.float32)
    arrays = {
        "means": _positions(means, version, fraction),
        "quats": _smallest_three(quats) if version >= 3 else _imaginary(quats),
        "log_scales": scales.astype(np.float32) / 16 - 10,
        "logit_opacities": logits(alphas[:, 0].astype(np.float32) / 255),
        "sh": np.concatenate((base, (rest - 128) / 128), axis=1).astype(np.float32),
    }
    return arrays, _axes(extensions if flags & EXTENDED else b"")


def _axes(records: bytes) -> Float64:
    """Return `frame` by a file's extensions; the last record of a coordinate system is valid.

    The records are `u32 type, u32 length, payload` (extensions/README.md of Niantic's spz); unknown
    types are skipped, and a record that is cut off ends them, as for the format's own reader.
    """
    place, system = 0, 0
    while place + 8 <= len(records):
        kind, length = struct.unpack_from("<II", records, place)
        if kind == COORDINATES and length >= 4 and place + 12 <= len(records):
            (system,) = struct.unpack_from("<I", records, place + 8)
        place += 8 + length
    if system > len(SYSTEMS):
        raise NotSupportedError(f"coordinate system {system} of SPZ")
    matrix = np.zeros((3, 3))
    for axis, letter in enumerate(SYSTEMS[system - 1] if system else "RUB"):
        if letter in "RUB":
            matrix["RUB".index(letter), axis] = 1
        else:
            matrix["LDF".index(letter), axis] = -1
    return matrix


def _positions(found: NDArray[np.uint8], version: int, fraction: int) -> Float32:
    """Return positions (N, 3) from half floats in version 1, else from 24-bit fixed point."""
    if version == 1:
        return np.asarray(found.view("<f2").astype(np.float32))
    whole = np.zeros((len(found), 3, 4), np.uint8)
    whole[:, :, 1:] = found.reshape(-1, 3, 3)
    values = whole.view("<i4")[:, :, 0] >> 8  # keeps the sign
    return np.asarray(values.astype(np.float32) / np.float32(1 << fraction))


def _imaginary(found: NDArray[np.uint8]) -> Float32:
    """Return quaternions (N, 4), wxyz, of versions 1 and 2, which store x, y and z."""
    xyz = found.astype(np.float32) / np.float32(127.5) - 1
    real = np.sqrt(np.maximum(1 - np.square(xyz).sum(axis=1, keepdims=True), 0))
    return np.asarray(np.concatenate((real, xyz), axis=1).astype(np.float32))


def _smallest_three(found: NDArray[np.uint8]) -> Float32:
    """Return quaternions (N, 4), wxyz, of versions 3 and 4: the three smallest, in 10 bits each."""
    packed = found.view("<u4")[:, 0].copy()
    largest = packed >> 30
    xyzw = np.zeros((len(packed), 4), np.float32)
    for axis in (3, 2, 1, 0):
        rows = largest != axis
        bits = packed[rows]
        size = (bits & 511).astype(np.float32) * np.float32(np.sqrt(0.5) / 511)
        xyzw[rows, axis] = np.where(bits >> 9 & 1, -size, size)
        packed[rows] >>= 10
    rest = np.sqrt(np.maximum(1 - np.square(xyzw).sum(axis=1), 0))
    xyzw[np.arange(len(packed)), largest] = rest
    return np.roll(xyzw, 1, axis=1)


def _gunzipped(unpacker: Any, wanted: int, *, extended: bool) -> tuple[bytes, bytes]:
    """Return the `wanted` bytes of the sections of versions 1 to 3, and the extensions after."""
    most = wanted + (MOST_RECORDS if extended else 0)
    found = bytearray()
    while len(found) <= most and not unpacker.eof:
        part = unpacker.decompress(unpacker.unconsumed_tail, min(1 << 20, most + 1 - len(found)))
        if not part:
            break
        found += part
    if len(found) < wanted or len(found) > most or not unpacker.eof:
        raise ValueError(f"it has {len(found)} of {wanted} bytes")
    if unpacker.unused_data.strip(b"\0"):  # gzip itself ignores zeros
        raise ValueError("something follows its end")
    return bytes(found[:wanted]), bytes(found[wanted:])


def _zstd(raw: bytes, streams: int, sizes: list[int]) -> tuple[bytes, bytes]:
    """Return the sections of version 4, each packed on its own, and the extensions before them."""
    table = struct.unpack_from("<I", raw, 16)[0]
    if not 5 <= streams <= 6 or table < 32 or table + 16 * streams > len(raw):
        raise ValueError("its header promises more than it has")
    found = struct.unpack_from(f"<{2 * streams}Q", raw, table)
    if sizes[:streams] != list(found[1::2]) or any(sizes[streams:]):
        raise ValueError("its parts do not belong to its Gaussians")
    start = table + 16 * streams
    if start + sum(found[::2]) > len(raw):
        raise ValueError("it is truncated")
    zstd: Any = package("zstandard", "SPZ of version 4")
    sections = bytearray()
    for packed, unpacked in zip(found[::2], found[1::2], strict=True):
        part = raw[start : start + packed]
        start += packed
        if not unpacked:
            continue
        # The size in a stream's header is the size that is allocated for it.
        said = zstd.get_frame_parameters(part).content_size
        if said not in (0, unpacked, zstd.CONTENTSIZE_UNKNOWN):
            raise ValueError("a part has another size than its header says")
        sections += zstd.ZstdDecompressor().decompress(part, max_output_size=unpacked)
    if len(sections) != sum(sizes):
        raise ValueError("its parts do not belong to its Gaussians")
    return bytes(sections), raw[32:table]
