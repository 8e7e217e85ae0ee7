"""Reads glTF 2.0 files for Gaussians and meshes: JSON, numbers and bytes.

All counts are compared with the size of the file before memory is allocated for them.
"""

from __future__ import annotations

import base64
import json
import os
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..formats.files import read_bytes
from ..formats.names import inner_path
from ..model.scene import Float64
from .libraries import MOST_PARTS, NotSupportedError, read_beside, refuse_bomb

FLOAT, BYTE = 5126, 5121
KINDS = {5120: "i1", BYTE: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", FLOAT: "<f4"}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
INSTANCES = "EXT_mesh_gpu_instancing"
MAGIC, VERSION, JSON, BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
MOST_JSON = 16 << 20  # bytes
MOST_VALUES = 4 << 20
"""Values of JSON; each takes up to a hundred bytes of memory, and two in the file."""

Wanted = Callable[[dict[str, Any]], bool]
"""Whether a primitive is to be read."""


def shown(record: dict[str, Any], wanted: Wanted) -> list[tuple[Float64, dict[str, Any]]]:
    """Return the wanted primitives of the scene, one for each node, with their place (4, 4).

    If the scene has none, return those of all nodes; if no node has any, those of all meshes.
    """
    meshes = [
        [item for item in mesh["primitives"] if wanted(item)] for mesh in record.get("meshes", [])
    ]
    nodes = record.get("nodes", [])
    below = {child for node in nodes for child in node.get("children", [])}
    scenes = record.get("scenes") or [{}]
    roots_of_scene = scenes[record.get("scene", 0)].get("nodes", [])
    for roots in (roots_of_scene, [k for k in range(len(nodes)) if k not in below]):
        if found := _placed(nodes, roots, meshes):
            return found
    if any(meshes[node["mesh"]] for node in nodes if "mesh" in node):
        raise ValueError("its nodes form a circle")
    _refuse_many(sum(map(len, meshes)))
    return [(np.eye(4), item) for mesh in meshes for item in mesh]


def _placed(
    nodes: list[dict[str, Any]], roots: Iterable[int], meshes: list[list[dict[str, Any]]]
) -> list[tuple[Float64, dict[str, Any]]]:
    """Return the primitives of these nodes and all nodes below them; see `shown`."""
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
    """Raise NotSupportedError for too many primitives, before each gets its place."""
    if count > MOST_PARTS:
        raise NotSupportedError(f"glTF with {count:,} primitives or more")


def _node_matrix(node: dict[str, Any]) -> Float64:
    """Return the (4, 4) transform from a node to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    if "rotation" in node:
        matrix[:3, :3] = Rotation.from_quat(node["rotation"]).as_matrix()
    matrix[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), np.float64).reshape(3)
    matrix[:3, 3] = np.array(node.get("translation", (0, 0, 0)), np.float64).reshape(3)
    return matrix


class GltfFile:
    """A glTF file: its JSON, its binary data, and the amount of data read so far."""

    def __init__(self, path: Path) -> None:
        """Read a GLB, or the JSON of a .gltf; ValueError if it is neither."""
        self.path = path
        raw = read_bytes(path, most=None)
        self.size, self.values_read = len(raw), 0
        self.buffers: dict[int, bytes] = {}
        self.beside: dict[str, bytes] = {}  # content of files by their names
        text = raw if path.suffix.lower() == ".gltf" else self._json_of_glb(raw)
        # A .gltf may be large: it may contain its data as base64, which has none of these letters.
        if sum(map(text.count, (b",", b"[", b"{"))) > MOST_VALUES:
            raise ValueError("its JSON has too many values")
        self.record: dict[str, Any] = json.loads(text)
        if not isinstance(self.record, dict):
            raise ValueError("no object of JSON")

    def _json_of_glb(self, raw: bytes) -> bytes:
        """Return the first chunk, the JSON; the next binary chunk becomes the first buffer."""
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

    def count(self, more: int) -> None:
        """Count `more` bytes as read; ValueError for a file that repeats its data too often."""
        self.values_read += more
        refuse_bomb(self.size, self.values_read)

    def values(self, number: int) -> NDArray[np.float32]:
        """Return an accessor's values; normalized integers become numbers from -1 or 0 to 1."""
        values = self.rows(number)
        if self.record["accessors"][number].get("normalized") and values.dtype.kind != "f":
            values = np.maximum(values / np.iinfo(values.dtype).max, -1)
        return values.astype(np.float32)

    def rows(self, number: int) -> NDArray[Any]:
        """Return an accessor's values (count, width) as they are in the file."""
        accessor = self.record["accessors"][number]
        kind: np.dtype[Any] = np.dtype(KINDS[accessor["componentType"]])
        count, width = int(accessor["count"]), COMPONENTS[accessor["type"]]
        self.count(4 * count * width)
        if "bufferView" in accessor:
            values = self._numbers(accessor, count, width, kind)
        else:
            values = np.zeros((count, width), kind)
        if sparse := accessor.get("sparse"):
            replaced = int(sparse["count"])
            self.count(4 * replaced * (width + 1))
            whole = np.dtype(KINDS[sparse["indices"]["componentType"]])
            rows = self._numbers(sparse["indices"], replaced, 1, whole)[:, 0]
            if whole.kind == "f" or rows.min() < 0:
                raise ValueError("it replaces values that it does not have")
            values = values.copy()
            values[rows] = self._numbers(sparse["values"], replaced, width, kind)
        return values

    def _numbers(
        self, place: dict[str, Any], count: int, width: int, kind: np.dtype[Any]
    ) -> NDArray[Any]:
        """Return the values (count, width) of an accessor, or of a part of a sparse one."""
        view = self.record["bufferViews"][place["bufferView"]]
        data, start = self.view(place["bufferView"]), int(place.get("byteOffset", 0))
        stride = int(view.get("byteStride", width * kind.itemsize))
        end = start + stride * (count - 1) + width * kind.itemsize
        if count < 1 or start < 0 or stride < width * kind.itemsize or end > len(data):
            raise ValueError("an accessor is longer than the file")
        return np.ndarray((count, width), kind, data, start, (stride, kind.itemsize))

    def view(self, number: int) -> memoryview:
        """Return the bytes of a buffer view."""
        view = self.record["bufferViews"][number]
        for name in view.get("extensions", {}):
            raise NotSupportedError(name)
        data = self._buffer(int(view.get("buffer", 0)))
        start, length = int(view.get("byteOffset", 0)), int(view["byteLength"])
        if start < 0 or length < 0 or start + length > len(data):
            raise ValueError("a buffer view is longer than the file")
        return memoryview(data)[start : start + length]

    def _buffer(self, number: int) -> bytes:
        """Return the bytes of a buffer: the GLB's own, a `data:` URI's, or another file's."""
        if number not in self.buffers:
            uri = self.record["buffers"][number].get("uri")
            if not isinstance(uri, str):
                raise ValueError("no binary part")
            # The size of the file already includes a buffer of `data:`.
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
