"""Files as the command `surface` writes them: a ball with a texture, apart at the seam."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from tests.addon.colmap_project import write_png

ROUND, TALL = 24, 12
CENTRE, RADIUS = np.array([0.1, -0.05, 0.15]), 0.2


def write_ball(
    path: Path,
    *,
    radius: float = RADIUS,
    colour: int | tuple[int, int, int] = 200,
    result: str = "",
) -> None:
    """A ball's .glb, and its record; `result` is the SHA-256 of what it was made of."""
    v, u = np.mgrid[0 : TALL + 1, 0 : ROUND + 1]
    tilt, turn = np.pi * v / TALL, 2 * np.pi * (u % ROUND) / ROUND
    flat = np.sin(tilt) * (v < TALL)
    ball = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.cos(tilt)], axis=-1)
    a = v[:-1, :-1] * (ROUND + 1) + u[:-1, :-1]
    b, c, d = a + ROUND + 1, a + ROUND + 2, a + 1
    faces = np.concatenate([np.stack([a, b, c], -1)[:-1], np.stack([a, c, d], -1)[1:]], axis=None)
    arrays = {
        "POSITION": (CENTRE + radius * ball).reshape(-1, 3).astype("<f4"),
        "TEXCOORD_0": np.stack([u / ROUND, v / TALL], axis=-1).reshape(-1, 2).astype("<f4"),
        "indices": faces.astype("<u4").reshape(-1, 1),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    picture = path.with_suffix(".png")
    write_png(picture, np.full((8, 8, 3), colour, np.uint8))
    parts = [*(array.tobytes() for array in arrays.values()), picture.read_bytes()]
    picture.unlink()
    views, begin = [], 0
    for part in parts:
        views.append({"buffer": 0, "byteOffset": begin, "byteLength": len(part)})
        begin += len(part) + -len(part) % 4
    binary = b"".join(part + bytes(-len(part) % 4) for part in parts)
    kinds = {1: ("SCALAR", 5125), 2: ("VEC2", 5126), 3: ("VEC3", 5126)}
    accessors = [
        {
            "bufferView": number,
            "count": len(array),
            "type": kinds[array.shape[1]][0],
            "componentType": kinds[array.shape[1]][1],
        }
        for number, array in enumerate(arrays.values())
    ]
    textured = {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}
    record = {
        "meshes": [{"primitives": [textured]}],
        "accessors": accessors,
        "bufferViews": views,
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
    }
    text = json.dumps(record).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    facts = {"faces": len(faces) // 3, "size": [2 * radius] * 3, "filled": 0.03}
    facts |= {"volume": 4 / 3 * np.pi * radius**3, "watertight": True, "result": result}
    path.with_suffix(".surface.json").write_text(json.dumps(facts))
