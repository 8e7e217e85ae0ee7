"""COLMAP projects for the add-on's tests, with numpy alone: a real Blender has nothing else."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from tests.poses import Y_DOWN, look_at

WIDTH, HEIGHT = 64, 48
PARAMS = (60.0, 54.0, 30.0, 26.0)  # fx, fy, cx, cy
POINTS = 200


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """wxyz of a rotation matrix, w > 0."""
    w = np.sqrt(max(1 + np.trace(rotation), 1e-12)) / 2
    if w > 1e-3:
        r = rotation
        x, y, z = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (4 * w)
        return np.array([w, x, y, z])
    values, vectors = np.linalg.eigh(rotation + rotation.T)  # a half turn about the last axis
    return np.array([0.0, *vectors[:, np.argmax(values)]])


def ring(count: int, radius: float = 3.0) -> np.ndarray:
    """(count, 4, 4) poses around the origin, all looking at it."""
    angles = 2 * np.pi * (np.arange(count) + 0.25) / count
    eyes = np.stack([radius * np.sin(angles), np.full(count, -1.0), -radius * np.cos(angles)], 1)
    return np.array([look_at(eye, up=Y_DOWN) for eye in eyes])


def write_project(
    folder: Path,
    photos: int = 8,
    *,
    tracks: bool = True,
    bend: float = 0.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Path:
    """A text model with points in [-0.5, 0.5]^3 and photos that show them as coloured dots.

    `bend` is the radial distortion of the lens (k1), of which the model's camera knows nothing.
    `origin` is where the model puts the middle of the points.
    """
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (folder / "images").mkdir()
    random = np.random.default_rng(3)
    points = random.uniform(-0.5, 0.5, (POINTS, 3))
    colours = random.integers(40, 256, (POINTS, 3), np.uint8)
    sizes = f"{WIDTH} {HEIGHT} " + " ".join(map(str, PARAMS))
    (model / "cameras.txt").write_text(f"1 PINHOLE {sizes}\n")
    lines, observers = [], [[] for _ in points]
    for index, pose in enumerate(ring(photos)):
        local = points @ pose[:3, :3].T + pose[:3, 3]
        rays = local[:, :2] / local[:, 2:]
        rays *= 1 + bend * (rays**2).sum(axis=1, keepdims=True)
        pixels = rays * PARAMS[:2] + PARAMS[2:]
        shift = pose[:3, 3] - pose[:3, :3] @ origin
        numbers = " ".join(f"{v:.17g}" for v in (*quaternion(pose[:3, :3]), *shift))
        lines.append(f"{index + 1} {numbers} 1 photo {index}.png")
        inside = ((pixels > 0) & (pixels < (WIDTH, HEIGHT))).all(axis=1)
        seen = np.flatnonzero(inside) if tracks else []
        lines.append(" ".join(f"{pixels[k, 0]:.6f} {pixels[k, 1]:.6f} {k + 1}" for k in seen))
        for place, k in enumerate(seen):
            observers[k].append(f"{index + 1} {place}")
        write_png(folder / "images" / f"photo {index}.png", dots(pixels, colours))
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    rows = (
        f"{k + 1} {' '.join(f'{v:.17g}' for v in p)} {' '.join(map(str, c))} 0.5 {' '.join(o)}\n"
        for k, (p, c, o) in enumerate(zip(points + origin, colours, observers, strict=True))
    )
    (model / "points3D.txt").write_text("".join(rows))
    return folder


def dots(pixels: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) uint8: a small square at each pixel, on grey."""
    photo = np.full((HEIGHT, WIDTH, 3), 30, np.uint8)
    for (x, y), colour in zip(pixels.astype(int), colours, strict=True):
        photo[max(y - 1, 0) : max(y + 1, 0), max(x - 1, 0) : max(x + 1, 0)] = colour
    return photo


def write_png(path: Path, pixels: np.ndarray) -> None:
    """(H, W, 3) uint8 as a PNG."""
    path.write_bytes(png(pixels))


def png(pixels: np.ndarray) -> bytes:
    """The bytes of a PNG of (H, W, 3) uint8, without Pillow."""
    rows = np.concatenate(
        [np.zeros((len(pixels), 1), np.uint8), pixels.reshape(len(pixels), -1)], 1
    )
    header = struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], 8, 2, 0, 0, 0)
    written = b"\x89PNG\r\n\x1a\n"
    for kind, data in (
        (b"IHDR", header),
        (b"IDAT", zlib.compress(rows.tobytes())),
        (b"IEND", b""),
    ):
        checksum = struct.pack(">I", zlib.crc32(kind + data))
        written += struct.pack(">I", len(data)) + kind + data + checksum
    return written


def write_large_model(folder: Path, photos: int, points: int, seen: int) -> Path:
    """A binary model without photos' files: each photo observes `seen` points."""
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (folder / "images").mkdir()
    with (model / "cameras.bin").open("wb") as file:
        file.write(struct.pack("<QIiQQ4d", 1, 1, 1, WIDTH, HEIGHT, *PARAMS))
    random = np.random.default_rng(0)
    small = dots(np.zeros((0, 2)), np.zeros((0, 3)))
    observation = np.dtype([("xy", "<f8", 2), ("point", "<i8")])
    tracks = random.integers(0, points, (photos, seen))
    with (model / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", photos))
        for index, pose in enumerate(ring(photos)):
            pose_values = (*quaternion(pose[:3, :3]), *pose[:3, 3])
            file.write(struct.pack("<I7dI", index + 1, *pose_values, 1))
            file.write(f"{index:05d}.png\0".encode() + struct.pack("<Q", seen))
            rows = np.zeros(seen, observation)
            rows["xy"], rows["point"] = random.uniform(0, HEIGHT, (seen, 2)), tracks[index] + 1
            rows.tofile(file)
            write_png(folder / "images" / f"{index:05d}.png", small)
    order = np.argsort(tracks.ravel(), kind="stable")
    starts = np.searchsorted(tracks.ravel()[order], np.arange(points + 1))
    owners, places = np.divmod(order, seen)
    pairs = np.stack([owners + 1, places], axis=1).astype("<i4")
    positions = random.uniform(-1, 1, (points, 3))
    with (model / "points3D.bin").open("wb") as file:
        file.write(struct.pack("<Q", points))
        for k in range(points):
            low, high = starts[k], starts[k + 1]
            file.write(struct.pack("<Q3d3BdQ", k + 1, *positions[k], 9, 99, 200, 0.5, high - low))
            file.write(pairs[low:high].tobytes())
    return folder
