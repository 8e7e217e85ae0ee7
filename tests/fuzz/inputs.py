"""Good inputs, small, as trees of values and as the bytes of their files."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from roigs_engine.colmap.records import CAMERA_MODELS
from tests.addon.colmap_project import quaternion, ring

WIDTH, HEIGHT, PHOTOS, POINTS = 48, 36, 4, 40
PARAMS = [45.0, 40.0, 23.0, 19.0]  # fx, fy, cx, cy
BOX = {"name": "thing", "min": [-0.5, -0.5, -0.5], "max": [0.5, 0.5, 0.5]}
TURNED = {
    "name": "other",
    "world_to_box": [[0.0, 1.0, 0, 0.1], [-1.0, 0, 0, 0.0], [0.0, 0, 1.0, 0], [0.0, 0, 0, 1.0]],
    "half_extents": [0.4, 0.3, 0.5],
}
ROIS = {"rois": [BOX, TURNED]}
NAMES = [f"{k}.{'jpg' if k % 2 else 'png'}" for k in range(PHOTOS)]


def model(camera: str = "PINHOLE", params: Sequence[float] = PARAMS) -> dict[str, Any]:
    """A COLMAP model as lists of numbers and texts, in the order of its files."""
    random = np.random.default_rng(5)
    points = random.uniform(-0.45, 0.45, (POINTS, 3))
    number = [name for name, _ in CAMERA_MODELS].index(camera)
    images, tracks = [], [[] for _ in points]
    for index, (pose, name) in enumerate(zip(ring(PHOTOS, 2.0), NAMES, strict=True)):
        local = points @ pose[:3, :3].T + pose[:3, 3]
        pixels = local[:, :2] / local[:, 2:] * PARAMS[:2] + PARAMS[2:]
        seen = np.flatnonzero(((pixels > 0) & (pixels < (WIDTH, HEIGHT))).all(axis=1))
        numbers = [float(v) for v in (*quaternion(pose[:3, :3]), *pose[:3, 3])]
        observed = [[float(pixels[k, 0]), float(pixels[k, 1]), int(k) + 1] for k in seen]
        images.append([index + 1, numbers, 1, name, observed])
        for place, k in enumerate(seen):
            tracks[k].append([index + 1, place])
    return {
        "cameras": [[1, number, WIDTH, HEIGHT, [float(v) for v in params]]],
        "images": images,
        "points3D": [
            [k + 1, [float(v) for v in p], [9, 99, 200], 0.5, tracks[k]]
            for k, p in enumerate(points)
        ],
    }


def _fit(value: int, form: str) -> int:
    """The integer as that field would hold it."""
    bits = 8 * struct.calcsize("<" + form)
    value %= 1 << bits
    return value - (1 << bits) if form.islower() and value >> (bits - 1) else value


def _pack(form: str, *values: float) -> bytes:
    fitted = [v if f == "d" else _fit(int(v), f) for f, v in zip(form, values, strict=True)]
    return struct.pack("<" + form, *fitted)


def _utf8(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


def binary_files(tree: Mapping[str, Any]) -> dict[str, bytes]:
    """The model's .bin files."""
    cameras = [_pack("Q", len(tree["cameras"]))]
    for camera_id, number, width, height, params in tree["cameras"]:
        cameras.append(_pack("IiQQ", camera_id, number, width, height))
        cameras += [_pack("d", value) for value in params]
    images = [_pack("Q", len(tree["images"]))]
    for image_id, pose, camera_id, name, observed in tree["images"]:
        images += [_pack("I", image_id), *(_pack("d", v) for v in pose), _pack("I", camera_id)]
        images += [_utf8(name) + b"\0", _pack("Q", len(observed))]
        images += [
            b"".join(_pack(f, v) for f, v in zip("ddq", row, strict=False)) for row in observed
        ]
    points = [_pack("Q", len(tree["points3D"]))]
    for point_id, xyz, rgb, error, track in tree["points3D"]:
        points += [_pack("Q", point_id), *(_pack("d", v) for v in xyz)]
        points += [*(_pack("B", v) for v in rgb), _pack("dQ", error, len(track))]
        points += [_pack("I", value) for pair in track for value in pair]
    # The newer files, which the engine has no need of: nonsense in them must do no harm.
    extra = {"rigs.bin": b"\xff" * 40, "frames.bin": b"\xff" * 40}
    files = {"cameras.bin": cameras, "images.bin": images, "points3D.bin": points}
    return {name: b"".join(parts) for name, parts in files.items()} | extra


def text_files(tree: Mapping[str, Any]) -> dict[str, bytes]:
    """The model's .txt files."""
    names = dict(enumerate(name for name, _ in CAMERA_MODELS))

    def line(*values: Any) -> str:
        flat = [w for v in values for w in (np.ravel(v).tolist() if isinstance(v, list) else [v])]
        return " ".join(str(word) for word in flat) + "\n"

    def rows(table: list[list[float]]) -> list[float]:
        return [value for row in table for value in row]

    files = {
        "cameras.txt": [line(c[0], names.get(c[1], c[1]), *c[2:]) for c in tree["cameras"]],
        "images.txt": [line(*i[:4]) + line(*rows(i[4])) for i in tree["images"]],
        "points3D.txt": [line(*p[:4], *rows(p[4])) for p in tree["points3D"]],
    }
    return {name: _utf8("# made for a test\n" + "".join(parts)) for name, parts in files.items()}


def photo(form: str = "PNG", mode: str = "RGB", size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    """A photo with a slope in it."""
    from PIL import Image

    x = np.linspace(0, 255, size[0])[None, :, None]
    pixels = np.broadcast_to(x, (size[1], size[0], 3)).astype(np.uint8)
    image = Image.fromarray(pixels)
    if mode in ("I;16", "F"):
        grey = pixels[..., 0].astype(np.uint16 if mode == "I;16" else np.float32) * 200
        image = Image.fromarray(grey)
    elif mode != "RGB":
        image = image.convert(mode)
    file = io.BytesIO()
    image.save(file, form)
    return file.getvalue()


def turned_photo() -> bytes:
    """A JPEG that asks to be shown turned by 90 degrees."""
    from PIL import Image

    image = Image.open(io.BytesIO(photo("JPEG")))
    exif = image.getexif()
    exif[0x0112] = 6
    file = io.BytesIO()
    image.save(file, "JPEG", exif=exif)
    return file.getvalue()


def png_of_claimed_size(width: int, height: int) -> bytes:
    """A PNG whose header promises so many pixels, and whose data are a few bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(bytes(1 << 16))
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    )


def jpeg_of_claimed_size(width: int, height: int) -> bytes:
    """A JPEG whose frame header promises other sides than its data have."""
    data = photo("JPEG")
    at = data.index(b"\xff\xc0")
    return data[: at + 5] + struct.pack(">HH", height, width) + data[at + 9 :]


def ply_names(bands: int = 4) -> list[str]:
    """The columns of a Gaussian PLY."""
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{k}" for k in range(3 * (bands - 1))]
    return [*names, "opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]


def ply_table(bands: int = 4, count: int = 30) -> np.ndarray:
    """(count, columns) of Gaussians around the origin."""
    random = np.random.default_rng(6)
    names = ply_names(bands)
    table = random.normal(0, 0.3, (count, len(names)))
    for k in range(3):
        table[:, names.index(f"scale_{k}")] -= 3
    return table


PLY_TYPES = {"float": "f4", "double": "f8", "uchar": "u1", "short": "i2", "int": "i4"}


def ply(form: str, elements: Sequence[Sequence[Any]], table: np.ndarray) -> bytes:
    """A PLY: `elements` are [name, count, [[type, property], ...]]; the table is the first's."""
    lines = ["ply", f"format {form} 1.0"]
    for name, count, properties in elements:
        lines.append(f"element {name} {count}")
        lines += [f"property {kind} {word}" for kind, word in properties]
    head = "\n".join([*lines, "end_header", ""]).encode("utf-8", "replace")
    if form == "ascii":
        return head + "\n".join(" ".join(f"{v:g}" for v in row) for row in table).encode()
    order = ">" if form == "binary_big_endian" else "<"
    kinds = [PLY_TYPES.get(kind, "f4") for kind, _ in elements[0][2]] if elements else []
    with np.errstate(all="ignore"):
        columns = [
            table[:, k % table.shape[1]].astype(order + kind) for k, kind in enumerate(kinds)
        ]
    rows = [
        b"".join(column[row : row + 1].tobytes() for column in columns) for row in range(len(table))
    ]
    return head + b"".join(rows)


def good_ply() -> bytes:
    """A PLY without a fault."""
    properties = [["float", name] for name in ply_names()]
    return ply("binary_little_endian", [["vertex", 30, properties]], ply_table())


def camera_path() -> dict[str, Any]:
    """Two cameras of a path file."""
    pose = ring(2, 2.0)
    return {
        "cameras": [
            {
                "name": f"view {k}",
                "width": WIDTH,
                "height": HEIGHT,
                **dict(zip(("fx", "fy", "cx", "cy"), PARAMS, strict=True)),
                "world_to_camera": pose[k].tolist(),
            }
            for k in range(2)
        ]
    }
