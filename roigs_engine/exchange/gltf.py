"""glTF 2.0 with Khronos's extension KHR_gaussian_splatting, as one GLB, through pygltflib.

A viewer without the extension shows points in the colours of `COLOR_0`.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..formats.files import write_bytes
from ..model.gaussians import SH_C0
from ..model.scene import Float64
from .arrays import Arrays, logits, opacities, unit_quats
from .libraries import package
from .transform import moved

TITLE = "glTF"
NAME = "KHR_gaussian_splatting"
SH_NAMES = [
    f"{NAME}:SH_DEGREE_{degree}_COEF_{k}" for degree in range(4) for k in range(2 * degree + 1)
]
MEANING = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "sortingMethod": "cameraDistance",
    "projection": "perspective",
}
FLOAT, BYTE, POINTS, ARRAY_BUFFER = 5126, 5121, 0, 34962
KINDS = {5120: "i1", BYTE: "u1", 5122: "<i2", 5123: "<u2", FLOAT: "<f4"}
COMPONENTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
MAGIC, VERSION, JSON, BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
MOST_JSON = 16 << 20  # bytes


def write(path: Path, arrays: Arrays) -> int:
    """See `FileFormat`."""
    gltf: Any = package("pygltflib", TITLE)
    made = gltf.GLTF2(asset=gltf.Asset(generator="ROI-GS"), extensionsUsed=[NAME], scene=0)
    blob = bytearray()
    attributes = gltf.Attributes()
    for name, values in _columns(arrays).items():
        accessor = gltf.Accessor(
            bufferView=len(made.bufferViews),
            componentType=BYTE if values.dtype == np.uint8 else FLOAT,
            normalized=values.dtype == np.uint8,
            count=len(values),
            type={1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.size // len(values)],
        )
        if name == "POSITION":
            accessor.min = values.min(axis=0).tolist()
            accessor.max = values.max(axis=0).tolist()
        place = {"buffer": 0, "byteOffset": len(blob), "byteLength": values.nbytes}
        made.bufferViews.append(gltf.BufferView(**place, target=ARRAY_BUFFER))
        blob += values.tobytes()
        setattr(attributes, name, len(made.accessors))
        made.accessors.append(accessor)
    primitive = gltf.Primitive(attributes=attributes, mode=POINTS, extensions={NAME: dict(MEANING)})
    made.meshes.append(gltf.Mesh(primitives=[primitive]))
    made.nodes.append(gltf.Node(mesh=0))
    made.scenes.append(gltf.Scene(nodes=[0]))
    made.buffers.append(gltf.Buffer(byteLength=len(blob)))
    made.set_binary_blob(bytes(blob))
    write_bytes(path, b"".join(made.save_to_bytes()))
    return len(arrays["means"])


def _columns(arrays: Arrays) -> dict[str, NDArray[Any]]:
    """Attribute -> values, every one a multiple of four bytes long."""
    sh = arrays["sh"].astype(np.float32)
    colour = np.column_stack((0.5 + SH_C0 * sh[:, 0], opacities(arrays)))
    columns: dict[str, NDArray[Any]] = {
        "POSITION": arrays["means"].astype(np.float32),
        "COLOR_0": np.clip(np.round(colour * 255), 0, 255).astype(np.uint8),
        f"{NAME}:ROTATION": np.roll(unit_quats(arrays), -1, axis=1),  # xyzw
        f"{NAME}:SCALE": np.exp(arrays["log_scales"]).astype(np.float32),
        f"{NAME}:OPACITY": opacities(arrays),
    }
    for index, name in enumerate(SH_NAMES[: sh.shape[1]]):
        columns[name] = np.ascontiguousarray(sh[:, index])
    return columns


def read(path: Path) -> Arrays:
    """See `FileFormat`: the Gaussians of a GLB with one such primitive, where its node has them."""
    record, blob = _parts(path)
    found = [
        (number, primitive["attributes"], primitive["extensions"][NAME].get("extensions", {}))
        for number, mesh in enumerate(record.get("meshes", []))
        for primitive in mesh["primitives"]
        if NAME in primitive.get("extensions", {})
    ]
    if len(found) != 1:
        raise ValueError(f"{len(found)} primitives with {NAME}, not one")
    ((mesh, at, inner),) = found
    for name in inner:  # others may be ignored
        if "compression" in name:
            raise ValueError(f"its Gaussians are packed by {name}")

    def get(name: str) -> NDArray[np.float32]:
        if name not in at:
            raise ValueError(f"no attribute {name}")
        return _values(record, blob, int(at[name]))

    there = next((k for k, name in enumerate(SH_NAMES) if name not in at), len(SH_NAMES))
    bands = max((k for k in (1, 4, 9, 16) if k <= there), default=1)
    arrays = {
        "means": get("POSITION"),
        "quats": np.roll(get(f"{NAME}:ROTATION"), 1, axis=1),
        "log_scales": np.log(np.maximum(get(f"{NAME}:SCALE"), 1e-30)),
        "logit_opacities": logits(get(f"{NAME}:OPACITY").reshape(-1)),
        "sh": np.stack([get(name) for name in SH_NAMES[:bands]], axis=1),
    }
    return moved(arrays, _transform(record, mesh))


def _transform(record: dict[str, Any], mesh: int) -> Float64:
    """(4, 4) from a mesh to the scene."""
    nodes = record.get("nodes", [])
    shown = [number for number, node in enumerate(nodes) if node.get("mesh") == mesh]
    if len(shown) > 1:
        raise ValueError(f"its Gaussians are shown {len(shown)} times, not once")
    parents = {child: k for k, node in enumerate(nodes) for child in node.get("children", [])}
    matrix = np.eye(4)
    number = shown[0] if shown else None
    for _ in nodes:
        if number is None:
            break
        matrix = _node_matrix(nodes[number]) @ matrix
        number = parents.get(number)
    if number is not None and nodes:
        raise ValueError("its nodes form a circle")
    return matrix


def _node_matrix(node: dict[str, Any]) -> Float64:
    """(4, 4) from a node to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    if "rotation" in node:
        matrix[:3, :3] = Rotation.from_quat(node["rotation"]).as_matrix()
    matrix[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), np.float64).reshape(3)
    matrix[:3, 3] = np.array(node.get("translation", (0, 0, 0)), np.float64).reshape(3)
    return matrix


def _parts(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary part of a GLB."""
    raw = path.read_bytes()
    magic, version, _, size, kind = struct.unpack_from("<5I", raw)
    if (magic, version, kind) != (MAGIC, VERSION, JSON) or size > MOST_JSON:
        raise ValueError("no GLB 2.0")
    record = json.loads(raw[20 : 20 + size])
    length, kind = struct.unpack_from("<2I", raw, 20 + size)
    blob = raw[28 + size : 28 + size + length]
    if kind != BIN or len(blob) != length or not isinstance(record, dict):
        raise ValueError("no binary part")
    return record, blob


def _values(record: dict[str, Any], blob: bytes, number: int) -> NDArray[np.float32]:
    """The values of an accessor; normalized integers become numbers from -1 or 0 to 1."""
    accessor = record["accessors"][number]
    if "sparse" in accessor or "bufferView" not in accessor:
        raise ValueError("an accessor is sparse")
    view = record["bufferViews"][accessor["bufferView"]]
    if packed := [*view.get("extensions", {})]:
        raise ValueError(f"its values are packed by {packed[0]}")
    if view.get("buffer", 0) != 0:
        raise ValueError("its values are in another file")
    kind: np.dtype[Any] = np.dtype(KINDS[accessor["componentType"]])
    count, width = int(accessor["count"]), COMPONENTS[accessor["type"]]
    start = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
    stride = int(view.get("byteStride", width * kind.itemsize))
    end = start + stride * (count - 1) + width * kind.itemsize
    if count < 1 or start < 0 or stride < width * kind.itemsize or end > len(blob):
        raise ValueError("an accessor is longer than the file")
    values: NDArray[Any] = np.ndarray((count, width), kind, blob, start, (stride, kind.itemsize))
    if accessor.get("normalized") and kind.kind != "f":
        values = np.maximum(values / np.iinfo(kind).max, -1)
    return values.astype(np.float32)
