"""Gaussians in the 3DGS PLY layout that every splat viewer reads; numpy only.

Layout (docs/conventions.md): binary little-endian float32 `x y z nx ny nz f_dc_0..2 f_rest_0..44
opacity scale_0..2 rot_0..3`; `f_rest` channel-major (15 red, 15 green, 15 blue), opacity a logit,
scales natural logarithms, rotation wxyz. Values go out and come back bit for bit.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RunFolderError
from .files import atomic_write

Float32 = NDArray[np.float32]
# What a PLY may call its scalar types, and how numpy reads them.
SCALARS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "<i2", "int16": "<i2", "ushort": "<u2", "uint16": "<u2",
    "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4",
    "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip
MAX_HEADER = 1 << 16


def _columns(rest: int) -> list[str]:
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{k}" for k in range(rest)]
    names += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    return names


def write_ply(path: Path, arrays: Mapping[str, Float32]) -> None:
    """Write Gaussians under `path`, whole or not at all.

    Args:
        path: the file to write.
        arrays: float32 `means` (N, 3), `quats` (N, 4), `log_scales` (N, 3), `logit_opacities` (N,),
            `sh` (N, K, 3) with K = 1, 4, 9 or 16.
    """
    sh = arrays["sh"]
    count, bands = sh.shape[:2]
    rest = 3 * (bands - 1)
    names = _columns(rest)
    table = np.zeros((count, len(names)), dtype="<f4")
    table[:, 0:3] = arrays["means"]
    table[:, 6:9] = sh[:, 0]
    table[:, 9 : 9 + rest] = sh[:, 1:].transpose(0, 2, 1).reshape(count, rest)
    table[:, -8] = arrays["logit_opacities"]
    table[:, -7:-4] = arrays["log_scales"]
    table[:, -4:] = arrays["quats"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    with atomic_write(path) as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(table.data)


def read_ply(path: Path) -> dict[str, Float32]:
    """The arrays of `write_ply`, read by property name; extra properties are passed over.

    Files without normals and with fewer spherical-harmonics bands are accepted.

    Raises:
        RunFolderError: the file is not a binary little-endian Gaussian PLY, or is cut short.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise RunFolderError(f"Cannot read {path} ({error.strerror}).") from error
    count, dtype, start = _parse_header(path, data)
    if len(data) - start < count * dtype.itemsize:
        held = (len(data) - start) // max(dtype.itemsize, 1)
        raise RunFolderError(f"{path} is cut short: {held} of {count} Gaussians are there.")
    table = np.frombuffer(data, dtype, count, start)
    rest = sum(name.startswith("f_rest_") for name in dtype.names or ())
    missing = [n for n in _columns(rest) if n not in (dtype.names or ()) and not n.startswith("n")]
    if missing or rest not in (0, 9, 24, 45):
        what = f"no {missing[0]}" if missing else f"{rest} f_rest properties"
        raise RunFolderError(f"{path} is not a Gaussian PLY ({what}).")

    def gather(prefix: str, number: int) -> Float32:
        gathered = np.empty((count, number), np.float32)
        for k in range(number):
            gathered[:, k] = table[f"{prefix}{k}"]
        return gathered

    higher = gather("f_rest_", rest).reshape(count, 3, rest // 3).transpose(0, 2, 1)
    return {
        "means": np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float32),
        "quats": gather("rot_", 4),
        "log_scales": gather("scale_", 3),
        "logit_opacities": table["opacity"].astype(np.float32),
        "sh": np.concatenate([gather("f_dc_", 3)[:, None], higher], axis=1),
    }


def _parse_header(path: Path, data: bytes) -> tuple[int, np.dtype[Any], int]:
    """Vertex count, row type and offset of the first row."""
    end = re.search(rb"end_header\r?\n", data[:MAX_HEADER])
    if not data.startswith(b"ply") or end is None:
        raise RunFolderError(f"{path} is not a PLY file.")
    count, in_vertex, form = -1, False, ""
    fields: dict[str, str] = {}
    for line in data[: end.start()].decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:1] == ["format"]:
            form = " ".join(words[1:2])
        elif words[:1] == ["element"] and len(words) == 3:
            in_vertex = words[1] == "vertex"
            if words[1] == "chunk":
                raise RunFolderError(f"{path} is a compressed PLY.", "Save it uncompressed.")
            if in_vertex == (count >= 0):
                raise RunFolderError(f"{path}: one vertex element must come first.")
            if in_vertex:
                count = _count(path, words[2])
        elif words[:1] == ["property"] and in_vertex:
            if len(words) != 3 or words[1] not in SCALARS or words[2] in fields:
                raise RunFolderError(f"{path}: cannot read '{line.strip()}'.")
            fields[words[2]] = SCALARS[words[1]]
    if form != "binary_little_endian":
        raise RunFolderError(
            f"{path} is a PLY in the format '{form}'.", "Save it as binary little-endian."
        )
    if count < 0 or not fields:
        raise RunFolderError(f"{path} has no vertex element.")
    return count, np.dtype(list(fields.items())), end.end()


def _count(path: Path, word: str) -> int:
    """The number of rows that a header announces."""
    if not re.fullmatch("[0-9]{1,18}", word):
        raise RunFolderError(f"{path}: '{word:.20}' is no number of vertices.")
    return int(word)
