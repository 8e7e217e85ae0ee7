"""Niantic's SPZ, through the package gsply: version 3 (gzip) is written, 1 to 4 are read.

Positions are fixed-point numbers with 24 bits, so their resolution follows from the model's size.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ConfigError
from ..formats.drawable import FLAT
from ..formats.files import write_bytes
from .arrays import Arrays, Check, Float32, in_morton_order, nothing, unit_quats
from .compressed_ply import arrays_of
from .libraries import package, refuse_bomb, scratch

TITLE = "SPZ"
MAGIC, GZIP = 0x5053474E, b"\x1f\x8b"
BITS = 24  # of a coordinate, with its sign
MOST_FRACTION = 20  # bits behind the point
SMALL, FINER = 0.05, 4  # a step is 2^-FINER of the size that this share of the Gaussians is below
FARTHEST = 1000.0  # times the median distance from the origin: what is beyond is left out
SCALES = (-10.0, 5.9375)  # logarithms that it can hold
LOST = 0.01  # share of Gaussians whose size it may change, or that it may leave out
STEPS = (4 / 128, 6 / 128, 8 / 128, 10 / 128)
"""Of SH above degree 0; its own encoder has 16 / 128 above degree 1: 3 dB less than the last."""
PART = 8.1  # the finest step is taken with which the file is at most this part of a PLY
BLOCKS, BLOCK = 8, 4096  # of rows that tell how small the file becomes
SH_ROWS = {0: 0, 1: 3, 2: 8, 3: 15}
MOST = 50_000_000  # Gaussians
FLAGS, ANTIALIASED = 14, 0x1
"""Byte of the header with flags, in all versions, and the one of anti-aliased Gaussians."""
HEAD = 1 << 16  # bytes of a file that hold its header, packed or not


def write(
    path: Path,
    arrays: Arrays,
    *,
    step: float | None = None,  # of SH above degree 0; None: the finest that makes a small file
    antialiased: bool = False,
    check: Check = nothing,
) -> int:
    """See `FileFormat`. Gaussians that are far outside are left out."""
    arrays = in_morton_order(arrays)
    scales = arrays["log_scales"]
    # Points without any size do not count: they would have none in a model of another scale.
    small = (scales < SCALES[0]).all(axis=1) & (scales > FLAT / 2).any(axis=1)
    outside = small | (scales > SCALES[1]).any(axis=1)
    if outside.mean() > LOST:
        raise ConfigError(
            "The Gaussians are too small or too large for SPZ.",
            "Scale the model to a size of a few units, or use another format.",
        )
    reach = np.abs(arrays["means"].astype(np.float32)).max(axis=1)
    farthest = max(1e-6, min(float(reach.max()), FARTHEST * float(np.median(reach))))
    free = BITS - 1 - np.ceil(np.log2(farthest))
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
    write_bytes(path, data)
    return int(inside.sum())


def _packed(arrays: Arrays, fraction: int, step: float, *, antialiased: bool = False) -> bytes:
    """The file of these Gaussians, with so many bits behind the point and this step of SH."""
    gsply: Any = package("gsply", TITLE)
    spz: Any = package("gsply.spz", TITLE)
    sh = arrays["sh"].astype(np.float32)
    sh[:, 1:] = np.round(sh[:, 1:] / step) * step  # compresses to less
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
    # What gsply compresses with is fast, and makes files that are a tenth larger.
    return gzip.compress(whole, 6, mtime=0)


def _finest(arrays: Arrays, fraction: int, check: Check) -> float:
    """The finest step of SH with which the file is small, by a sample of the Gaussians."""
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
    """Bits behind the point after which small Gaussians move by less than anybody sees."""
    small = np.quantile(log_scales.mean(axis=1), SMALL) / np.log(2)
    return int(np.clip(np.ceil(FINER - small), 1, MOST_FRACTION))


def read(path: Path) -> Arrays:
    """See `FileFormat`."""
    spz: Any = package("gsply.spz", TITLE)
    _check(path)
    return arrays_of(spz.read_spz(path))


def is_antialiased(path: Path) -> bool:
    """Whether a file's header says that its Gaussians are drawn with anti-aliasing."""
    with open(path, "rb") as file:
        head = file.read(HEAD)
    if head[:2] == GZIP:
        head = zlib.decompressobj(wbits=31).decompress(head, FLAGS + 1)
    return bool(head[FLAGS] & ANTIALIASED)


def _check(path: Path) -> None:
    """Compare what the header promises with what is there: gsply unpacks all of it first."""
    raw = path.read_bytes()
    if raw[:2] == GZIP:
        _check_gzip(path, raw)
        return
    if len(raw) < 32:
        raise ValueError("no header")
    magic, version, count, degree, _, _, streams, table = struct.unpack_from("<IIIBBBBI", raw)
    if magic != MAGIC or version != 4 or degree not in SH_ROWS or not 5 <= streams <= 6:
        raise ValueError("its header is not that of SPZ")
    if not 0 < count <= MOST or table < 32 or table + 16 * streams > len(raw):
        raise ValueError("its header promises more than it has")
    sizes = struct.unpack_from(f"<{2 * streams}Q", raw, table)
    widths = (9, 1, 3, 3, 4, 3 * SH_ROWS[degree])[:streams]
    if [count * width for width in widths] != list(sizes[1::2]):
        raise ValueError("its parts do not belong to its Gaussians")
    start = table + 16 * streams
    if start + sum(sizes[::2]) > len(raw):
        raise ValueError("it is truncated")
    refuse_bomb(path, sum(sizes[1::2]))
    zstd: Any = package("zstandard", "SPZ of version 4")
    for packed, unpacked in zip(sizes[::2], sizes[1::2], strict=True):
        # What a stream says of itself is what is allocated for it.
        said = zstd.get_frame_parameters(raw[start : start + packed]).content_size
        if said not in (0, unpacked, zstd.CONTENTSIZE_UNKNOWN):
            raise ValueError("a part has another size than its header says")
        start += packed


def _check_gzip(path: Path, raw: bytes) -> None:
    unpacker = zlib.decompressobj(wbits=31)
    head = unpacker.decompress(raw, 16)
    magic, version, count, degree, *_ = struct.unpack("<IIIBBBB", head)
    if magic != MAGIC or version not in (1, 2, 3) or degree not in SH_ROWS:
        raise ValueError("its header is not that of SPZ")
    if not 0 < count <= MOST:
        raise ValueError(f"{count} Gaussians")
    refuse_bomb(path, count * 16)
    width = 16 + 3 * SH_ROWS[degree] + (4 if version == 3 else 3)
    wanted, there = count * (width - (3 if version == 1 else 0)), 0
    while there <= wanted and not unpacker.eof:
        part = unpacker.decompress(unpacker.unconsumed_tail, 1 << 20)
        if not part:
            break
        there += len(part)
    if there != wanted or not unpacker.eof:
        raise ValueError(f"it has {there} of {wanted} bytes")
    if unpacker.unused_data:  # gsply would unpack it too, whatever its size
        raise ValueError("something follows its end")
