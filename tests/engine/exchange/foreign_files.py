"""Small files as other programs write them, built from known values by the formats' descriptions.

Every one holds `COUNT` Gaussians with `VALUES`, in the file's own axes.
"""

from __future__ import annotations

import base64
import gzip
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

COUNT = 5
SH_C0 = 0.28209479177387814
ROWS = {0: 0, 1: 3, 2: 8, 3: 15, 4: 24}


def values(degree: int = 0) -> dict[str, np.ndarray]:
    """Values that each file can hold within its precision; `sh` has any degree."""
    dice = np.random.default_rng(degree)
    quats = dice.normal(size=(COUNT, 4))
    quats[:, 0] = 2  # SPZ 1 and 2 do not store it, so little of it would be rough
    return {
        "means": dice.integers(-64, 64, (COUNT, 3)) / 16,
        "quats": quats / np.linalg.norm(quats, axis=1, keepdims=True),
        "log_scales": dice.integers(-80, 0, (COUNT, 3)) / 16,
        "logit_opacities": dice.normal(size=COUNT),
        "sh": dice.uniform(-0.9, 0.9, (COUNT, (degree + 1) ** 2, 3)),
    }


def alphas(model: dict[str, np.ndarray]) -> np.ndarray:
    return 1 / (1 + np.exp(-model["logit_opacities"]))


# --- SPZ ---


def record(kind: int, payload: bytes) -> bytes:
    """An extension."""
    return struct.pack("<II", kind, len(payload)) + payload


def spz(model: dict[str, np.ndarray], version: int, extensions: bytes = b"") -> bytes:
    """An SPZ of any version, with 12 bits behind the point."""
    degree = int(np.sqrt(model["sh"].shape[1])) - 1
    flags = 2 if extensions else 0
    count = len(model["means"])
    head = struct.pack("<IIIBBBB", 0x5053474E, version, count, degree, 12, flags, 0)
    parts = [
        _positions(model["means"], version),
        np.round(alphas(model) * 255).astype("u1").tobytes(),
        np.round((model["sh"][:, 0] * 0.15 + 0.5) * 255).astype("u1").tobytes(),
        ((model["log_scales"] + 10) * 16).astype("u1").tobytes(),
        _rotations(model["quats"], version),
        np.round(model["sh"][:, 1:] * 128 + 128).astype("u1").tobytes(),
    ]
    if version < 4:
        return gzip.compress(head + b"".join(parts) + extensions)
    import zstandard

    parts = parts if degree else parts[:5]
    packed = [zstandard.ZstdCompressor().compress(part) for part in parts]
    head = head[:15] + struct.pack("<BI12x", len(parts), 32 + len(extensions))
    table = b"".join(struct.pack("<QQ", len(a), len(b)) for a, b in zip(packed, parts, strict=True))
    return head + extensions + table + b"".join(packed)


def _positions(means: np.ndarray, version: int) -> bytes:
    if version == 1:
        return means.astype("<f2").tobytes()
    fixed = np.round(means * 4096).astype("<i4").reshape(-1)
    return b"".join(struct.pack("<i", int(number))[:3] for number in fixed)


def _rotations(quats: np.ndarray, version: int) -> bytes:
    if version < 3:
        return np.round((quats[:, 1:] + 1) * 127.5).astype("u1").tobytes()
    out = b""
    for xyzw in np.roll(quats, -1, axis=1):
        largest = int(np.argmax(np.abs(xyzw)))
        sign = np.sign(xyzw[largest])
        word = largest
        for axis in (axis for axis in range(4) if axis != largest):
            size = int(np.abs(xyzw[axis]) / np.sqrt(0.5) * 511 + 0.5)
            word = word << 10 | int(xyzw[axis] * sign < 0) << 9 | size
        out += struct.pack("<I", word)
    return out


# --- glTF ---

NAME = "KHR_gaussian_splatting"


class Gltf:
    """A glTF under construction: a record and its binary part."""

    def __init__(self) -> None:
        """Without any Gaussians."""
        self.blob = b""
        self.record: dict[str, Any] = {
            "asset": {"version": "2.0"},
            **{key: [] for key in ("accessors", "bufferViews", "meshes", "nodes")},
            "scenes": [{"nodes": []}],
        }

    def view(self, data: bytes) -> int:
        """The number of a new buffer view."""
        place = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)}
        self.record["bufferViews"].append(place)
        self.blob += data + bytes(-len(data) % 4)
        return len(self.record["bufferViews"]) - 1

    def accessor(self, rows: np.ndarray, **more: Any) -> int:
        """The number of a new accessor; normalized if its numbers are signed or unsigned bytes."""
        kinds = {"f4": 5126, "u1": 5121, "i1": 5120, "u2": 5123, "i2": 5122}
        kind = f"{rows.dtype.kind}{rows.dtype.itemsize}"
        made = {"componentType": kinds[kind], "count": len(rows), "bufferView": 0, **more}
        made["type"] = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[rows.size // len(rows)]
        if kind in ("u1", "i1"):
            made["normalized"] = True
        made["bufferView"] = self.view(rows.tobytes())
        self.record["accessors"].append(made)
        return len(self.record["accessors"]) - 1

    def add(self, attributes: dict[str, int], extension: Any, **node: Any) -> dict[str, Any]:
        """Show a primitive by a mesh and a root node of its own; returns the primitive."""
        primitive = {"attributes": attributes, "mode": 0, "extensions": extension}
        self.record["nodes"].append({"mesh": len(self.record["meshes"]), **node})
        self.record["scenes"][0]["nodes"].append(len(self.record["nodes"]) - 1)
        self.record["meshes"].append({"primitives": [primitive]})
        return primitive

    def gaussians(self, model: dict[str, np.ndarray]) -> dict[str, int]:
        """Attributes as the ratified extension has them."""
        columns = {
            "POSITION": model["means"],
            f"{NAME}:ROTATION": np.roll(model["quats"], -1, axis=1),
            f"{NAME}:SCALE": np.exp(model["log_scales"]),
            f"{NAME}:OPACITY": alphas(model),
        }
        bands = [(d, k) for d in range(5) for k in range(2 * d + 1)]
        for index, (d, k) in enumerate(bands[: model["sh"].shape[1]]):
            columns[f"{NAME}:SH_DEGREE_{d}_COEF_{k}"] = model["sh"][:, index]
        return {name: self.accessor(rows.astype("<f4")) for name, rows in columns.items()}

    def glb(self) -> bytes:
        """All of it as one file."""
        self.record["buffers"] = [{"byteLength": len(self.blob)}]
        text = json.dumps(self.record).encode()
        text += b" " * (-len(text) % 4)
        size = 28 + len(text) + len(self.blob)
        head = struct.pack("<5I", 0x46546C67, 2, size, len(text), 0x4E4F534A)
        return head + text + struct.pack("<2I", len(self.blob), 0x004E4942) + self.blob

    def gltf(self, uri: str | None = None) -> str:
        """The text of a .gltf with its bytes inside, or in another file."""
        data = "data:application/octet-stream;base64," + base64.b64encode(self.blob).decode()
        self.record["buffers"] = [{"byteLength": len(self.blob), "uri": uri or data}]
        return json.dumps(self.record)


def own(**more: Any) -> dict[str, Any]:
    """The extension of a primitive."""
    return {NAME: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", **more}}


def saved(path: Path, data: bytes | str) -> Path:
    """Written."""
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path
