"""PlayCanvas's compressed PLY format, through the package gsply."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..formats.files import read_bytes, regular, write_bytes
from ..formats.ply_rows import read_header
from ..formats.splat_ply import made_lines
from ..formats.targets import PLAIN, Target
from ..machine import package
from .arrays import Arrays, unit_quats
from .libraries import NotSupportedError

TITLE = "compressed PLY"
CHUNK = 256  # Gaussians that share their bounds
BYTES = {"chunk": (72, 48), "vertex": (16,), "sh": (9, 24, 45)}
"""Element -> sizes that one of them may have, in bytes."""


def write(path: Path, arrays: Arrays, *, target: Target = PLAIN) -> int:
    """See `FileFormat`. The header records the target of the Gaussians."""
    gsply: Any = package("gsply", TITLE)
    sh = arrays["sh"].astype(np.float32)
    data: bytes = gsply.compress_to_bytes(
        arrays["means"].astype(np.float32),
        arrays["log_scales"].astype(np.float32),
        unit_quats(arrays),
        arrays["logit_opacities"].astype(np.float32),
        np.ascontiguousarray(sh[:, 0]),
        np.ascontiguousarray(sh[:, 1:]) if sh.shape[1] > 1 else None,
    )
    # gsply writes no comments; they follow the format, as in a plain PLY
    lines = "".join(f"\n{line}" for line in made_lines(target))
    data = data.replace(b"\nelement ", f"{lines}\nelement ".encode(), 1)
    write_bytes(path, data)
    return len(sh)


def read(path: Path) -> Arrays:
    """See `FileFormat`."""
    gsply: Any = package("gsply", TITLE)
    if _check(path) == BYTES["chunk"][0]:
        return arrays_of(gsply.plyread(path))
    return arrays_of(gsply.decompress_from_bytes(_with_colours(read_bytes(path, most=None))))


def _with_colours(data: bytes) -> bytes:
    """Add bounds of colours, 0 to 1, to the chunks of a file of SuperSplat before 1.0.

    gsply reads no file without them.
    """
    head, body = re.split(rb"\r?\nend_header\r?\n", data, maxsplit=1)
    names = [f"property float {side}_{c}\n".encode() for side in ("min", "max") for c in "rgb"]
    count = int(re.findall(rb"\nelement chunk ([0-9]+)", head)[0])
    head = head.replace(b"\r\n", b"\n")
    head = head.replace(b"element vertex", b"".join(names) + b"element vertex", 1)
    old = np.frombuffer(body, "<f4", 12 * count).reshape(count, 12)
    bounds = np.tile(np.array([0, 0, 0, 1, 1, 1], "<f4"), (count, 1))
    chunks: bytes = np.concatenate((old, bounds), axis=1).tobytes()
    return head + b"\nend_header\n" + chunks + body[old.nbytes :]


def arrays_of(data: Any) -> Arrays:
    """Return the arrays of gsply's container, as those of a PLY."""
    sh = data.sh0[:, None, :]
    if data.shN is not None and data.shN.size:
        sh = np.concatenate((sh, data.shN), axis=1)
    found = {
        "means": data.means,
        "quats": data.quats,
        "log_scales": data.scales,
        "logit_opacities": np.reshape(data.opacities, -1),
        "sh": sh,
    }
    return {name: np.ascontiguousarray(values, np.float32) for name, values in found.items()}


def _check(path: Path) -> int:
    """Check the header, which gsply trusts, against the file's size; return a chunk's bytes."""
    with open(path, "rb", opener=regular) as file:
        form, elements = read_header(file, path)
        there = os.fstat(file.fileno()).st_size - file.tell()
    counts = {element.name: element.count for element in elements}
    bytes_of = {e.name: sum(np.dtype(k).itemsize for k in e.fields.values()) for e in elements}
    if form != "binary_little_endian":
        raise NotSupportedError(f"a compressed PLY in the format '{form:.30}'")
    if not {"chunk", "vertex"} <= counts.keys() or len(counts) < len(elements):
        raise ValueError("its elements are not those of a compressed PLY")
    if more := counts.keys() - BYTES.keys():
        raise NotSupportedError(f"the element '{min(more):.30}' of a compressed PLY")
    if any(e.lists or bytes_of[e.name] not in BYTES[e.name] for e in elements):
        raise NotSupportedError("a compressed PLY with other properties than PlayCanvas's")
    if -(-counts["vertex"] // CHUNK) != counts["chunk"]:
        raise ValueError("its chunks do not belong to its Gaussians")
    if counts.get("sh", counts["vertex"]) != counts["vertex"]:
        raise ValueError("its colours do not belong to its Gaussians")
    wanted = sum(counts[name] * bytes_of[name] for name in counts)
    if there < wanted:
        raise ValueError(f"it has {there} of {wanted} bytes")
    return bytes_of["chunk"]
