"""Cases of meshes (.glb): damaged records, numbers and pictures, and records that claim much."""

from __future__ import annotations

import functools
import io
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.cases import Case, write
from tests.fuzz.damage import bytes_damaged, tree_damaged
from tests.fuzz.exchange import INSTALLED, MANY, glb_of, good

OUT = (".ply", ".obj", ".stl", ".usdz", ".html")
PROGRAM = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(it ran) print showpage\n"
"""A picture that is a program."""


@functools.cache
def picture(kind: str = "PNG", side: int = 8, *, progressive: bool = False) -> bytes:
    """A picture of one colour."""
    from PIL import Image

    out = io.BytesIO()
    Image.new("RGB", (side, side), (200, 60, 20)).save(out, kind, progressive=progressive)
    return out.getvalue()


def mesh_record(texture: bytes) -> tuple[dict[str, Any], bytes]:
    """A pyramid with a texture: the record of its glTF, and its binary part."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4")
    faces = np.array([0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3], "<u4")
    columns = {
        "POSITION": ("VEC3", corners),
        "NORMAL": ("VEC3", corners - 0.25),
        "TEXCOORD_0": ("VEC2", corners[:, :2]),
        "_filled": ("SCALAR", corners[:, 0]),
        "": ("SCALAR", faces),
    }
    views, blob = [], b""
    for content in (*(rows.tobytes() for _, rows in columns.values()), texture):
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(content)})
        blob += content + bytes(-len(content) % 4)
    accessors = [
        {
            "bufferView": number,
            "componentType": 5126 if rows.dtype.kind == "f" else 5125,
            "count": len(rows),
            "type": kind,
        }
        for number, (kind, rows) in enumerate(columns.values())
    ]
    at = {name: number for number, name in enumerate(columns) if name}
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    record = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": np.eye(4).ravel().tolist()}],
        "meshes": [{"primitives": [{"attributes": at, "indices": len(at), "material": 0}]}],
        "materials": [material],
        "textures": [{"source": 0}],
        "images": [{"bufferView": len(columns), "mimeType": "image/png"}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    return record, blob


def repeated(record: dict[str, Any], kind: int) -> None:
    """The same mesh again and again: by primitives, nodes, or values that no byte is of."""
    if kind == 0:
        record["meshes"][0]["primitives"] *= 50_000
    elif kind == 1:
        record["nodes"] = [{"children": list(range(1, 3001))}, *([{"mesh": 0}] * 3000)]
    elif kind == 2:
        record["nodes"] = [*({"children": [k + 1, k + 1]} for k in range(40)), {"mesh": 0}]
    else:
        del record["accessors"][0]["bufferView"]
        record["accessors"][0]["count"] = 300_000_000


ODD_FACES = (-1, -100, 2.7, -1e30, float("nan"), 4, 127)


def other_faces(dice: random.Random, record: dict[str, Any], blob: bytes) -> bytes:
    """The binary part with faces of other numbers: signed, floating, of no vertex."""
    code, kind = dice.choice(((5120, "i1"), (5122, "<i2"), (5125, "<u4"), (5126, "<f4")))
    faces = np.array([0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3], "<f4")
    faces[dice.randrange(12)] = dice.choice(ODD_FACES)
    with np.errstate(all="ignore"):
        content = faces.astype(kind).tobytes()
    start = record["bufferViews"][4]["byteOffset"]
    record["accessors"][4]["componentType"] = code
    return blob[:start] + content + blob[start + len(content) :]


def other_place(dice: random.Random) -> dict[str, Any]:
    """A node that places its mesh by odd numbers."""
    odd = dice.choice((float("nan"), float("inf"), 1e300, -1e300, 1e39, 1e20, 0.0, 1e-300, -1.0))
    key = dice.choice(("matrix", "translation", "scale", "rotation"))
    numbers = {"matrix": np.eye(4).ravel().tolist(), "rotation": [0.0, 0.0, 0.0, 1.0]}
    values = numbers.get(key, [1.0, 1.0, 1.0])
    for place in dice.sample(range(len(values)), dice.choice((1, 1, len(values)))):
        values[place] = odd
    return {"mesh": 0, key: values}


def mesh(dice: random.Random, folder: Path) -> Case:
    """A mesh into other formats, and onto a page beside Gaussians."""
    odd = (b"", PROGRAM, b"<svg/>", bytes_damaged(dice, picture()), picture("GIF"))
    kind = dice.randrange(11)
    texture = dice.choice(odd) if kind == 0 else picture(dice.choice(("PNG", "JPEG")))
    record, blob = mesh_record(texture)
    if kind == 1:
        record = tree_damaged(dice, record, most=2)
    elif kind == 2:
        record = tree_damaged(dice, record, same_type=True, most=1)
    elif kind == 3:
        accessor = dice.choice(record["accessors"])
        key = dice.choice(("count", "type", "componentType", "bufferView", "byteOffset"))
        accessor[key] = dice.choice((*MANY, "SCALAR", "VEC2", "VEC4", 5121, 5126, -1, 3))
    elif kind == 4:
        odd_numbers = np.array([np.nan, np.inf, -1e38, 1e38, 0], "<f4")
        at = 4 * dice.randrange(len(blob) // 4 - 5)
        blob = blob[:at] + odd_numbers.tobytes() + blob[at + 20 :]
    elif kind == 5:
        blob = bytes_damaged(dice, blob)
    elif kind == 6:
        repeated(record, dice.randrange(4))
    elif kind == 8:
        blob = other_faces(dice, record, blob)
    elif kind == 9:
        record["nodes"] = [other_place(dice)]
    elif kind == 10:  # scans of a JPEG, few or many
        data = picture("JPEG", progressive=True)
        scan = data[data.rindex(b"\xff\xda") : -2]
        record, blob = mesh_record(data[:-2] + scan * dice.choice((1, 50, 300)) + data[-2:])
    data = glb_of(record, blob)
    if kind == 7:
        data = bytes_damaged(dice, data)
    source, ending = write(folder / "in" / "a.glb", data), dice.choice(OUT)
    out = str(folder / "out" / f"b{ending}")
    if ending == ".html":
        model = write(folder / "in" / "b.ply", good(".ply", 1))
        return Case(["convert", str(model), out, "--mesh", str(source), "--from-up", "z"])
    return Case(["convert", str(source), out])


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = (
    {"convert_mesh": (mesh, 300)} if INSTALLED else {}
)
