"""Reads the textured mesh of a box from the engine's glTF file. Numpy only, no bpy.

Blender's own importer may be switched off. It also rotates axes and splits vertices at the seams of
the texture, so meshes are not watertight. Here, equal vertices are merged, and positions stay
exact.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..shared import files, text

NUMBERS = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
"""glTF's component types."""
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
MOST_BYTES = 256 << 20
WRONG = (struct.error, ValueError, LookupError, TypeError, AttributeError, OverflowError)
"""Exceptions raised for a damaged record."""
PICTURES = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")
"""First bytes of allowed textures, PNG and JPEG. Blender reads many more formats."""
HEADER = struct.Struct("<4sII")
CHUNK = struct.Struct("<II")


@dataclass(frozen=True, kw_only=True, eq=False)
class TexturedMesh:
    """Triangles with a picture.

    Attributes:
        vertices: (V, 3) float32, in the frame of the COLMAP model.
        corners: (F, 3) int32, the vertices of each triangle.
        uv: (F, 3, 2) float32, places of its corners in the picture; v points up.
        picture: contents of an image file.
    """

    vertices: NDArray[np.float32]
    corners: NDArray[np.int32]
    uv: NDArray[np.float32]
    picture: bytes


def read_glb(path: Path) -> TexturedMesh:
    """Read the first mesh of a file.

    Raises:
        OSError: it cannot be read, or is not a file.
        ValueError: it is damaged, or not a mesh with a texture, in one line.
    """
    data = files.read_bytes(path, MOST_BYTES)
    try:
        magic, _, _ = HEADER.unpack_from(data)
        size, _ = CHUNK.unpack_from(data, HEADER.size)
        begin = HEADER.size + CHUNK.size
        if magic != b"glTF":
            raise ValueError("no glTF")
        return _mesh(text.parse_json(data[begin : begin + size]), data[begin + size + CHUNK.size :])
    except WRONG as error:
        raise ValueError(f"{path} is damaged, or not the mesh of a box.") from error


def _mesh(record: Any, binary: bytes) -> TexturedMesh:
    part = record["meshes"][0]["primitives"][0]
    names = part["attributes"]
    places = _numbers(record, binary, names["POSITION"])
    corners = _numbers(record, binary, part["indices"]).reshape(-1, 3)
    points = _numbers(record, binary, names["TEXCOORD_0"])
    if (places.shape[1], points.shape[1]) != (3, 2) or not np.isfinite(places).all():
        raise ValueError("not at numbers")
    uv = np.nan_to_num(points)[corners] * (1, -1) + (0, 1)
    rows = np.ascontiguousarray(places).view(np.dtype((np.void, 3 * places.itemsize))).ravel()
    _, first, welded = np.unique(rows, return_index=True, return_inverse=True)
    corners = welded.ravel()[corners].astype(np.int32)
    flat = (corners == corners[:, (1, 2, 0)]).any(axis=1)
    if flat.all():
        raise ValueError("no faces")
    colour = record["materials"][part["material"]]["pbrMetallicRoughness"]["baseColorTexture"]
    image = record["images"][record["textures"][colour["index"]]["source"]]
    picture = _bytes(record, binary, image["bufferView"])
    if not picture.startswith(PICTURES):
        raise ValueError("its picture is neither PNG nor JPEG")
    return TexturedMesh(
        vertices=places[first].astype(np.float32),
        corners=corners[~flat],
        uv=uv[~flat].astype(np.float32),
        picture=picture,
    )


def _numbers(record: Any, binary: bytes, index: int) -> NDArray[Any]:
    """(N, width) numbers of an accessor."""
    accessor = record["accessors"][index]
    width, kind = WIDTHS[accessor["type"]], NUMBERS[accessor["componentType"]]
    data = _bytes(record, binary, accessor["bufferView"])
    count = accessor["count"] * width
    return np.frombuffer(data, kind, count, accessor.get("byteOffset", 0)).reshape(-1, width)


def _bytes(record: Any, binary: bytes, index: int) -> bytes:
    view = record["bufferViews"][index]
    begin = view.get("byteOffset", 0)
    return binary[begin : begin + view["byteLength"]]
