"""glTF 2.0 with Khronos's extension KHR_gaussian_splatting, written as one GLB through pygltflib.

A viewer without the extension shows points in the colours of `COLOR_0`. Read are GLBs and .gltf,
also of the extension's drafts and with SPZ inside.
"""

from __future__ import annotations

import base64
import json
import os
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..formats.files import write_bytes
from ..formats.names import inner_path
from ..machine import package
from ..model.gaussians import SH_C0
from ..model.scene import Float64
from . import spz
from .arrays import Arrays, joined, logits, opacities, unit_quats
from .libraries import MOST_PARTS, NotSupportedError, read_beside, reading, refuse_bomb
from .transform import moved, recoloured

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
FLOAT, BYTE, POINTS, TRIANGLES, ARRAY_BUFFER = 5126, 5121, 0, 4, 34962
KINDS = {5120: "i1", BYTE: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", FLOAT: "<f4"}
COMPONENTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
DRAFTS = ("KHR_spz_gaussian_splats_compression", "KHR_spz_compression")
"""Extensions of primitives that became one of KHR_gaussian_splatting."""
INSTANCES = "EXT_mesh_gpu_instancing"
SRGB = ("srgb_rec709_display", "srgb_rec709_scene", "BT.709-sRGB")
LINEAR = ("lin_rec709_display", "lin_rec709_scene", "BT.709-linear")
"""Names of colour spaces: the ratified one, OpenUSD's, and one of a draft."""
LUF = np.diag((-1.0, 1.0, -1.0))  # from right, up and back
LEAST = 1e-30  # stands for a size of 0, which has no logarithm
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
    """See `FileFormat`: all Gaussians of the scene as one model, where their nodes have them."""
    file = _File(path)
    shown = _shown(file.record)
    if not shown:
        raise NotSupportedError(f"glTF without {NAME}")
    own = {id(item): item for _, item in shown}  # many nodes may show one
    read = {key: file.gaussians(item) for key, item in own.items()}
    refuse_bomb(file.size, sum(map(_bytes, (read[id(item)] for _, item in shown))))
    return joined([moved(read[id(item)], matrix) for matrix, item in shown])


def is_mesh(path: Path) -> bool:
    """Whether a GLB has triangles, and no Gaussians."""
    with reading(path, TITLE):
        record = _File(path).record
        every = [item for mesh in record.get("meshes", []) for item in mesh["primitives"]]
        return any(item.get("mode", TRIANGLES) == TRIANGLES for item in every) and not any(
            {NAME, *DRAFTS} & item.get("extensions", {}).keys() for item in every
        )


def _bytes(arrays: Arrays) -> int:
    return sum(rows.nbytes for rows in arrays.values())


def _shown(record: dict[str, Any]) -> list[tuple[Float64, dict[str, Any]]]:
    """The primitives of Gaussians of the scene, each with its place (4, 4), one for each node.

    Those of all nodes if the scene has none, and of all meshes if there are no nodes.
    """
    meshes = [
        [item for item in mesh["primitives"] if {NAME, *DRAFTS} & item.get("extensions", {}).keys()]
        for mesh in record.get("meshes", [])
    ]
    nodes = record.get("nodes", [])
    below = {child for node in nodes for child in node.get("children", [])}
    scenes = record.get("scenes") or [{}]
    shown = scenes[record.get("scene", 0)].get("nodes", [])
    for roots in (shown, [k for k in range(len(nodes)) if k not in below]):
        if found := _placed(nodes, roots, meshes):
            return found
    if any(meshes[node["mesh"]] for node in nodes if "mesh" in node):
        raise ValueError("its nodes form a circle")
    _refuse_many(sum(map(len, meshes)))
    return [(np.eye(4), item) for mesh in meshes for item in mesh]


def _placed(
    nodes: list[dict[str, Any]], roots: Iterable[int], meshes: list[list[dict[str, Any]]]
) -> list[tuple[Float64, dict[str, Any]]]:
    """See `_shown`: what these nodes and those below them show."""
    found: list[tuple[Float64, dict[str, Any]]] = []
    seen = set()
    waiting = [(number, np.eye(4)) for number in reversed(list(roots))]
    while waiting:
        number, above = waiting.pop()
        if number in seen:
            raise ValueError("its nodes form a circle")
        seen.add(number)
        node = nodes[number]
        matrix = above @ _node_matrix(node)
        waiting += [(child, matrix) for child in reversed(node.get("children", []))]
        items = meshes[node["mesh"]] if "mesh" in node else []
        if items and INSTANCES in node.get("extensions", {}):
            raise NotSupportedError(INSTANCES)
        _refuse_many(len(found) + len(items))
        found += [(matrix, item) for item in items]
    return found


def _refuse_many(count: int) -> None:
    """Raise NotSupportedError for so many primitives, before each gets its place."""
    if count > MOST_PARTS:
        raise NotSupportedError(f"glTF with {count:,} primitives of Gaussians or more")


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


class _File:
    """A glTF: its JSON, the bytes that this names, and what was read of them."""

    def __init__(self, path: Path) -> None:
        """Read a GLB, or the JSON of a .gltf; ValueError: it is neither."""
        self.path = path
        raw = path.read_bytes()
        self.size, self.values_read = len(raw), 0
        self.buffers: dict[int, bytes] = {}
        self.beside: dict[str, bytes] = {}  # content of files by their names
        self.packed: dict[tuple[int, bool], Arrays] = {}  # see `_spz`
        text = raw if path.suffix.lower() == ".gltf" else self._json_of_glb(raw)
        self.record: dict[str, Any] = json.loads(text)
        if not isinstance(self.record, dict):
            raise ValueError("no object of JSON")

    def _json_of_glb(self, raw: bytes) -> bytes:
        """Its first chunk; the next binary one becomes the first buffer."""
        magic, version, _, size, kind = struct.unpack_from("<5I", raw)
        if magic == MAGIC and version != VERSION:
            raise NotSupportedError(f"version {version} of GLB")
        if (magic, kind) != (MAGIC, JSON) or size > MOST_JSON:
            raise ValueError("no GLB 2.0")
        place = 20 + size
        while place + 8 <= len(raw):  # chunks of other kinds may follow
            length, kind = struct.unpack_from("<2I", raw, place)
            if kind == BIN:
                self.buffers[0] = raw[place + 8 : place + 8 + length]
                if len(self.buffers[0]) != length:
                    raise ValueError("its binary part is cut off")
                break
            place += 8 + length
        return raw[20 : 20 + size]

    def gaussians(self, item: dict[str, Any]) -> Arrays:
        """A primitive's, in its own frame."""
        extensions = item["extensions"]
        own = extensions.get(NAME, {})
        inner = {
            **own.get("extensions", {}),
            **{k: extensions[k] for k in DRAFTS if k in extensions},
        }
        packed = next((name for name in inner if "spz" in name.lower()), "")
        for name in inner:  # others may be ignored
            if "compression" in name and name != packed:
                raise NotSupportedError(name)
        arrays = self._spz(inner[packed], own) if packed else self._attributes(item["attributes"])
        space = own.get("colorSpace") or SRGB[0]
        if space in LINEAR:
            return {**arrays, "sh": recoloured(arrays["sh"].astype(np.float32))}
        if space not in SRGB:
            raise NotSupportedError(f"the colour space {space!s:.40}")
        return arrays

    def _attributes(self, at: dict[str, int]) -> Arrays:
        """As the extension has them, or its drafts, which had no prefix."""

        def get(*names: str) -> NDArray[np.float32]:
            there = next((name for name in names if name in at), None)
            if there is None:
                raise ValueError(f"no attribute {names[-1]}")
            return self._values(int(at[there]))

        rest = next((k for k, name in enumerate(SH_NAMES[1:]) if name not in at), len(SH_NAMES))
        rest = max(k for k in (0, 3, 8, 15) if k <= rest)
        scales = get(f"{NAME}:SCALE", "_SCALE")
        if not (scales < 0).any():  # drafts until February 2026 had logarithms
            scales = np.log(np.maximum(scales, LEAST))
        # Drafts had colours for the first coefficient, and opacities as their fourth number.
        if SH_NAMES[0] in at:
            base = get(SH_NAMES[0])
        else:
            base = (get("COLOR_0")[:, :3] - np.float32(0.5)) / np.float32(SH_C0)
        if f"{NAME}:OPACITY" in at:
            alpha = get(f"{NAME}:OPACITY")[:, 0]
        else:
            colours = get("COLOR_0")
            alpha = colours[:, 3] if colours.shape[1] == 4 else np.ones(len(colours), np.float32)
        return {
            "means": get("POSITION"),
            "quats": np.roll(get(f"{NAME}:ROTATION", "_ROTATION"), 1, axis=1),
            "log_scales": scales,
            "logit_opacities": logits(alpha),
            "sh": np.stack([base, *(get(name) for name in SH_NAMES[1 : 1 + rest])], axis=1),
        }

    def _spz(self, inside: dict[str, Any], own: dict[str, Any]) -> Arrays:
        """Of KHR_gaussian_splatting_compression_spz(_2): unpacked to left, up and front.

        Cesium's files of the drafts, which name no kernel, have glTF's axes as they are.
        """
        key = int(inside["bufferView"]), "kernel" in own
        if key in self.packed:  # of another primitive
            self._count(_bytes(self.packed[key]))
            return self.packed[key]
        raw = bytes(self._view(key[0]))
        arrays, axes = spz.unpacked(raw)
        self._count(_bytes(arrays))
        matrix = np.eye(4)
        matrix[:3, :3] = LUF @ axes if key[1] else axes
        self.packed[key] = moved(arrays, matrix)
        return self.packed[key]

    def _count(self, more: int) -> None:
        """Refuse a file that has the same numbers again and again."""
        self.values_read += more
        refuse_bomb(self.size, self.values_read)

    def _values(self, number: int) -> NDArray[np.float32]:
        """The values of an accessor; normalized integers become numbers from -1 or 0 to 1."""
        accessor = self.record["accessors"][number]
        kind: np.dtype[Any] = np.dtype(KINDS[accessor["componentType"]])
        count, width = int(accessor["count"]), COMPONENTS[accessor["type"]]
        self._count(4 * count * width)
        if "bufferView" in accessor:
            values = self._numbers(accessor, count, width, kind)
        else:
            values = np.zeros((count, width), kind)
        if sparse := accessor.get("sparse"):
            replaced = int(sparse["count"])
            whole = np.dtype(KINDS[sparse["indices"]["componentType"]])
            rows = self._numbers(sparse["indices"], replaced, 1, whole)[:, 0]
            values = values.copy()
            values[rows] = self._numbers(sparse["values"], replaced, width, kind)
        if accessor.get("normalized") and kind.kind != "f":
            values = np.maximum(values / np.iinfo(kind).max, -1)
        return values.astype(np.float32)

    def _numbers(
        self, place: dict[str, Any], count: int, width: int, kind: np.dtype[Any]
    ) -> NDArray[Any]:
        """(count, width) from where an accessor, or a part of a sparse one, says."""
        view = self.record["bufferViews"][place["bufferView"]]
        data, start = self._view(place["bufferView"]), int(place.get("byteOffset", 0))
        stride = int(view.get("byteStride", width * kind.itemsize))
        end = start + stride * (count - 1) + width * kind.itemsize
        if count < 1 or start < 0 or stride < width * kind.itemsize or end > len(data):
            raise ValueError("an accessor is longer than the file")
        return np.ndarray((count, width), kind, data, start, (stride, kind.itemsize))

    def _view(self, number: int) -> memoryview:
        """The bytes of a buffer view."""
        view = self.record["bufferViews"][number]
        for name in view.get("extensions", {}):
            raise NotSupportedError(name)
        data = self._buffer(int(view.get("buffer", 0)))
        start, length = int(view.get("byteOffset", 0)), int(view["byteLength"])
        if start < 0 or length < 0 or start + length > len(data):
            raise ValueError("a buffer view is longer than the file")
        return memoryview(data)[start : start + length]

    def _buffer(self, number: int) -> bytes:
        """The bytes of a buffer: the GLB's own, of a `data:` URI, or of a file beside it."""
        if number not in self.buffers:
            uri = self.record["buffers"][number].get("uri")
            if not isinstance(uri, str):
                raise ValueError("no binary part")
            # A buffer of `data:` is within the size of the file already.
            if uri.startswith("data:"):
                self.buffers[number] = base64.b64decode(uri.partition(",")[2], validate=True)
            else:  # any number of buffers may name one file
                name = unquote(uri)
                key = os.path.realpath(self.path.parent / (inner_path(name) or ""))
                if key not in self.beside:
                    self.beside[key] = read_beside(self.path, name)
                    self.size += len(self.beside[key])
                self.buffers[number] = self.beside[key]
        return self.buffers[number]
