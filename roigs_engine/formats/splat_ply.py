"""Gaussians in the 3DGS PLY layout that every splat viewer reads; numpy only.

docs/conventions.md has the layout. Values go out and come back bit for bit. Centres far from the
origin, as in map coordinates, are `double x y z`: float32 would be too coarse there.

Gaussians that were trained with anti-aliasing must be drawn with it. A comment says so:
`SplatRenderMode: mip`, as Brush, gsplat and PlayCanvas's splat-transform have it; Postshot's
`antialiased 1` is read too. So is Mip-Splatting's property `filter_3D`: such Gaussians were trained
with anti-aliasing, and as they are stored, they lack a blur in space that belongs to them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import RunFolderError
from .files import UNREADABLE, atomic_write, regular

HINT = "Give a PLY of 3D Gaussians, as training programs write them."
HINT_DAMAGED = "Write or download the file again."
Float32 = NDArray[np.float32]
Floats = NDArray[np.float32] | NDArray[np.float64]
# What a PLY may call its scalar types, and how numpy reads them.
SCALARS = {
    "char": "<i1", "uchar": "<u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4",
    "float": "<f4", "double": "<f8",
    "int8": "<i1", "uint8": "<u1", "int16": "<i2", "uint16": "<u2", "int32": "<i4",
    "uint32": "<u4", "float32": "<f4", "float64": "<f8",
}  # fmt: skip
REST_SIZES = (0, 9, 24, 45)  # numbers of `f_rest` columns for SH of degrees 0 to 3
MAX_HEADER = 1 << 20  # bytes; some programs write all their settings into comments
ANTIALIASED = "comment SplatRenderMode: mip"
"""Header line of Gaussians that are drawn with anti-aliasing."""
RENDER_MODE = re.compile(
    rb"^comment\s+(?:splatrendermode:\s*(mip|default)|antialiased\s+([01]))\s*$",
    re.IGNORECASE | re.MULTILINE,
)
FILTER = "filter_3D"
"""Property of Mip-Splatting: standard deviation of the blur in space."""
FILTER_LINE = re.compile(rb"^property\s+\S+\s+" + FILTER.encode() + rb"\s*$", re.MULTILINE)


def _columns(rest: int) -> list[str]:
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{k}" for k in range(rest)]
    names += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    return names


def write_ply(path: Path, arrays: Mapping[str, Floats], *, antialiased: bool = False) -> None:
    """Write Gaussians under `path`, whole or not at all.

    Args:
        path: the file to write.
        arrays: `means` (N, 3), float32 or, to be written as double, float64; float32 `quats`
            (N, 4), `log_scales` (N, 3), `logit_opacities` (N,), `sh` (N, K, 3) with K = 1, 4, 9
            or 16.
        antialiased: whether they are drawn with anti-aliasing.
    """
    sh = arrays["sh"]
    count, bands = sh.shape[:2]
    rest = 3 * (bands - 1)
    names = _columns(rest)
    table = np.zeros((count, len(names)), dtype="<f4")
    means = arrays["means"]
    table[:, 0:3] = means
    table[:, 6:9] = sh[:, 0]
    table[:, 9 : 9 + rest] = sh[:, 1:].transpose(0, 2, 1).reshape(count, rest)
    table[:, -8] = arrays["logit_opacities"]
    table[:, -7:-4] = arrays["log_scales"]
    table[:, -4:] = arrays["quats"]
    header = ["ply", "format binary_little_endian 1.0"]
    header += [ANTIALIASED] if antialiased else []
    header += [f"element vertex {count}"]
    types = dict.fromkeys(names, "float")
    rows: NDArray[Any] = table
    if means.dtype == np.float64:
        types |= dict.fromkeys(("x", "y", "z"), "double")
        rows = np.empty(count, [("means", "<f8", 3), ("others", "<f4", len(names) - 3)])
        rows["means"], rows["others"] = means, table[:, 3:]
    header += [f"property {types[name]} {name}" for name in names] + ["end_header", ""]
    with atomic_write(path) as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(rows.data)


def read_ply(path: str | Path) -> dict[str, Floats]:
    """The arrays of `write_ply`, read by property name.

    `means` is float64 if the file has double `x y z`; everything else is float32. Files without
    normals and with fewer SH bands are accepted. Mip-Splatting's `filter_3D` is applied; other
    extra properties are ignored.

    Raises:
        RunFolderError: the file is missing, truncated, or not a binary little-endian PLY of
            Gaussians; one line that says which.
    """
    return _decode(_table(path), path)


def is_antialiased(path: str | Path) -> bool:
    """Whether a PLY, compressed or not, says that its Gaussians are drawn with anti-aliasing.

    RunFolderError: it cannot be read.
    """
    try:
        with open(path, "rb", opener=regular) as file:
            head, _, _ = file.read(MAX_HEADER).partition(b"\nend_header")
    except OSError as error:
        raise RunFolderError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    said = [mode.lower() or flag for mode, flag in RENDER_MODE.findall(head)]
    if not said:
        return FILTER_LINE.search(head) is not None
    return said[-1] in (b"mip", b"1")


def check_ply(path: str | Path) -> None:
    """Raise as `read_ply`, from the header and the size of the file alone."""
    _decode(_table(path, rows=0), path)


def _table(path: str | Path, rows: int | None = None) -> NDArray[np.void]:
    """The rows of the file, all or the first ones."""
    try:
        with open(path, "rb", opener=regular) as file:
            count, row = _read_header(file, path)
            # Before memory is allocated for what a header promises.
            there = (os.fstat(file.fileno()).st_size - file.tell()) // row.itemsize
            if there < count:
                text = f"{path} is truncated: it has {there} of {count} Gaussians."
                raise RunFolderError(text, HINT_DAMAGED)
            return np.fromfile(file, row, count if rows is None else rows)
    except OSError as error:
        raise RunFolderError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error


def _read_header(file: BinaryIO, path: str | Path) -> tuple[int, np.dtype[np.void]]:
    """Number and type of the rows; leaves `file` at the first row."""
    head = file.read(MAX_HEADER)
    end = re.search(rb"\nend_header\r?\n", head)
    if not re.match(rb"ply\r?\n", head) or (end is None and len(head) < MAX_HEADER):
        raise RunFolderError(f"{path} is not a PLY file.", HINT)
    if end is None:
        text = f"{path}: the header of this PLY is longer than {MAX_HEADER >> 20} MB."
        raise RunFolderError(text, "Write it again with shorter comments.")
    file.seek(end.end())
    count, element, form = -1, "", ""
    fields: dict[str, str] = {}
    for line in head[: end.start()].decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case ["format", form, *_]:
                pass
            case ["element", "chunk", *_]:
                raise RunFolderError(f"{path} is a compressed PLY.", "Save it uncompressed.")
            case ["element", element, number]:
                if (element == "vertex") == (count >= 0):
                    raise RunFolderError(f"{path}: one vertex element must come first.", HINT)
                if element == "vertex":
                    if not re.fullmatch("[0-9]{1,18}", number):
                        text = f"{path}: '{number:.20}' is not a number of vertices."
                        raise RunFolderError(text, HINT)
                    count = int(number)
            case ["property", *words] if element == "vertex":
                if len(words) != 2 or words[0] not in SCALARS or words[1] in fields:
                    raise RunFolderError(f"{path}: cannot read '{line.strip():.60}'.", HINT)
                fields[words[1]] = SCALARS[words[0]]
    if form != "binary_little_endian":
        raise RunFolderError(
            f"{path} is a PLY in the format '{form:.60}'.", "Save it as binary little-endian."
        )
    if count < 0 or not fields:
        raise RunFolderError(f"{path} has no vertex element.", HINT)
    return count, np.dtype(list(fields.items()))


def _decode(table: NDArray[np.void], path: str | Path) -> dict[str, Floats]:
    names = table.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in REST_SIZES:
        raise RunFolderError(f"{path} is not a Gaussian PLY ({rest} properties f_rest).", HINT)
    missing = [n for n in _columns(rest) if n not in names and not n.startswith("n")]
    if missing:
        raise RunFolderError(f"{path} is not a Gaussian PLY (no property {missing[0]}).", HINT)
    # One gather of a plain matrix is several times faster than one pass per column.
    plain = all(table.dtype[name] == np.dtype("<f4") for name in names)
    matrix = table.view("<f4").reshape(len(table), len(names)) if plain else None

    def columns(wanted: list[str]) -> Float32:
        if matrix is not None:
            return matrix[:, [names.index(name) for name in wanted]]
        return np.stack([table[name].astype(np.float32) for name in wanted], axis=1)

    # The file holds all of red, then green, then blue; here a coefficient's colours lie together.
    sh = [f"f_dc_{c}" for c in range(3)]
    sh += [f"f_rest_{c * (rest // 3) + k}" for k in range(rest // 3) for c in range(3)]
    means: Floats = columns(["x", "y", "z"])
    if any(table.dtype[name] == np.dtype("<f8") for name in "xyz"):
        means = np.stack([table[name].astype(np.float64) for name in "xyz"], axis=1)
    log_scales = columns([f"scale_{k}" for k in range(3)])
    logit_opacities = columns(["opacity"])[:, 0]
    if FILTER in names:
        blur = columns([FILTER])[:, 0]
        log_scales, logit_opacities = _blurred(log_scales, logit_opacities, blur)
    return {
        "means": means,
        "quats": columns([f"rot_{k}" for k in range(4)]),
        "log_scales": log_scales,
        "logit_opacities": logit_opacities,
        "sh": columns(sh).reshape(len(table), 1 + rest // 3, 3),
    }


def _blurred(
    log_scales: Float32, logit_opacities: Float32, blur: Float32
) -> tuple[Float32, Float32]:
    """Logarithms of scales (N, 3), and logits (N,), after a blur in space (N,), world units.

    Mip-Splatting's 3D smoothing filter (Yu et al. 2024, sec. 5.1), as its renderer applies it: the
    opacity falls as the volume grows, so that the integral is the same.
    """
    log_scales, logit_opacities = log_scales.copy(), logit_opacities.copy()
    rows = blur != 0  # the others stay as they are, flat ones included
    before, logits = (a[rows].astype(np.float64) for a in (log_scales, logit_opacities))
    with np.errstate(all="ignore"):  # NaN stays NaN; the logarithm of an opacity of 0 is -Inf
        own = np.log(np.abs(blur[rows].astype(np.float64)))
        after = np.logaddexp(2 * before, 2 * own[:, None]) / 2
        opacity = (before - after).sum(axis=1) - np.logaddexp(0, -logits)  # its logarithm
        logit_opacities[rows] = opacity - np.log(-np.expm1(opacity))
    log_scales[rows] = after
    return log_scales, logit_opacities
