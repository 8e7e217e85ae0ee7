"""Gaussians from a 3DGS PLY (docs/conventions.md, section Files). Numpy only, no bpy."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

SCALARS = {
    "char": "<i1", "uchar": "<u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4",
    "float": "<f4", "double": "<f8",
    "int8": "<i1", "uint8": "<u1", "int16": "<i2", "uint16": "<u2", "int32": "<i4",
    "uint32": "<u4", "float32": "<f4", "float64": "<f8",
}  # fmt: skip
"""PLY's names of scalar types, old and new, as numpy's."""

REST_SIZES = (0, 9, 24, 45)
"""How many `f_rest` columns there are for SH of degrees 0 to 3."""

MAX_HEADER = 1 << 16  # bytes


@dataclass(frozen=True, kw_only=True, eq=False)
class SplatCloud:
    """N Gaussians as they are drawn, float32; K = 1, 4, 9 or 16 SH coefficients per colour.

    Attributes:
        means: (N, 3) centres.
        quats: (N, 4) unit quaternions, wxyz.
        scales: (N, 3) standard deviations.
        opacities: (N,) 0 to 1.
        sh: (N, K, 3) SH coefficients; a colour is max(0, 0.5 + sum of sh * basis), sRGB.
    """

    means: Float32
    quats: Float32
    scales: Float32
    opacities: Float32
    sh: Float32

    def __len__(self) -> int:
        return len(self.means)


def read_splats(path: str | Path) -> SplatCloud:
    """Read a PLY by property names; anything else in it is ignored.

    Gaussians that cannot be drawn are skipped: those with NaN or Inf, or a rotation of length zero.

    Raises:
        ValueError: the file is missing, truncated, or not a binary little-endian PLY of Gaussians;
            one line that says which.
    """
    try:
        with open(path, "rb") as file:
            count, row = _read_header(file, path)
            # Before memory is allocated for what a header promises.
            there = (os.fstat(file.fileno()).st_size - file.tell()) // row.itemsize
            if there < count:
                raise ValueError(f"{path} is truncated: it has {there} of {count} Gaussians.")
            table = np.fromfile(file, row, count)
    except OSError as error:
        raise ValueError(f"Cannot read {path} ({error.strerror}).") from error
    return _decode(table, path)


def _read_header(file: BinaryIO, path: str | Path) -> tuple[int, np.dtype[np.void]]:
    """Number and type of the rows; leaves `file` at the first row."""
    head = file.read(MAX_HEADER)
    end = re.search(rb"\nend_header\r?\n", head)
    if not re.match(rb"ply\r?\n", head) or end is None:
        raise ValueError(f"{path} is not a PLY file.")
    file.seek(end.end())
    count, element, fields = -1, "", {}
    for line in head[: end.start()].decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case ["format", form, *_] if form != "binary_little_endian":
                raise ValueError(f"{path} is a PLY of format '{form}', not binary_little_endian.")
            case ["element", element, number]:
                if count < 0 and element != "vertex":
                    raise ValueError(f"{path}: its first element is '{element}', not vertex.")
                if element == "vertex":
                    if count >= 0 or not re.fullmatch("[0-9]{1,18}", number):
                        raise ValueError(f"{path}: cannot read '{line:.60}'.")
                    count = int(number)
            case ["property", *words] if element == "vertex":
                if len(words) != 2 or words[0] not in SCALARS or words[1] in fields:
                    raise ValueError(f"{path}: cannot read '{line:.60}'.")
                fields[words[1]] = SCALARS[words[0]]
    if count < 0 or not fields:
        raise ValueError(f"{path} has no vertices.")
    return count, np.dtype(list(fields.items()))


def _decode(table: NDArray[np.void], path: str | Path) -> SplatCloud:
    """The columns as values that are drawn."""
    names = table.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in REST_SIZES:
        raise ValueError(f"{path} is not a PLY of Gaussians: it has {rest} properties f_rest.")
    higher = rest // 3
    # The file holds all of red, then green, then blue; here a coefficient's colours lie together.
    sh_names = [f"f_dc_{c}" for c in range(3)]
    sh_names += [f"f_rest_{c * higher + k}" for k in range(higher) for c in range(3)]
    quat_names = [f"rot_{k}" for k in range(4)]
    scale_names = [f"scale_{k}" for k in range(3)]
    missing = {"x", "y", "z", "opacity", *sh_names, *quat_names, *scale_names} - set(names)
    if missing:
        raise ValueError(f"{path} is not a PLY of Gaussians: it has no property {min(missing)}.")

    # One gather of a plain matrix is several times faster than one pass per column.
    plain = all(table.dtype[name] == np.dtype("<f4") for name in names)
    matrix = table.view("<f4").reshape(len(table), len(names)) if plain else None

    def columns(wanted: list[str]) -> Float32:
        if matrix is not None:
            return matrix[:, [names.index(name) for name in wanted]]
        return np.stack([table[name].astype(np.float32) for name in wanted], axis=1)

    quats, log_scales, logits = columns(quat_names), columns(scale_names), columns(["opacity"])
    with np.errstate(all="ignore"):  # what is out of range is skipped below
        cloud = {
            "means": columns(["x", "y", "z"]),
            "quats": quats / np.linalg.norm(quats, axis=1, keepdims=True),
            "scales": np.exp(log_scales),
            "opacities": 1 / (1 + np.exp(-logits[:, 0])),
            "sh": columns(sh_names).reshape(len(table), 1 + higher, 3),
        }
        usable = np.ones(len(table), bool)
        for values in cloud.values():
            usable &= np.isfinite(values.sum(axis=tuple(range(1, values.ndim))))
    if not usable.all():
        cloud = {name: values[usable] for name, values in cloud.items()}
    return SplatCloud(**cloud)
