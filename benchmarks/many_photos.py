"""Selection in scenes of many photos: `python -m benchmarks.many_photos FOLDER` (Linux, macOS).

Writes COLMAP models of a grid of cameras that all look at one box, and prints the seconds and the
peak memory of `select` for each number of photos. `--seen 0` writes no tracks.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.markdown import table
from roigs_engine.model.scene import Float64

BOX = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
SIZE = (640, 480)
POINT = np.dtype(
    [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("length", "<u8")]
)
OBSERVATION = np.dtype([("xy", "<f8", 2), ("id", "<i8")])


def grid_poses(count: int) -> Float64:
    """(count, 4, 4) world_to_camera of cameras in a square of 8 x 8 at height 4, looking at 0."""
    side = int(np.ceil(np.sqrt(count)))
    x, y = (np.indices((side, side)).reshape(2, -1)[:, :count] / max(side - 1, 1) - 0.5) * 8
    centres = np.column_stack([x, y, np.full(count, 4.0)])
    forward = -centres / np.linalg.norm(centres, axis=1, keepdims=True)
    right = np.cross(np.array([0.1, 1.0, 0.0]), forward)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    poses[:, :3, 3] = -np.einsum("vij,vj->vi", poses[:, :3, :3], centres)
    return poses


def write_scene(folder: Path, count: int, points: int, seen: int) -> None:
    """Write a COLMAP project. Each photo observes `seen` points in the box, which has 1 in 50."""
    rng = np.random.default_rng(0)
    model, photos = folder / "sparse/0", folder / "images"
    model.mkdir(parents=True)
    photos.mkdir()
    Image.new("RGB", SIZE, (90, 90, 90)).save(folder / "photo.jpg")
    record = np.zeros(points, POINT)
    record["id"], record["xyz"] = np.arange(points), rng.uniform(-4, 4, (points, 3))
    record["xyz"][:, 2] /= 8
    inside = max(seen, points // 50)
    record["xyz"][:inside] = rng.uniform(-0.5, 0.5, (inside, 3))
    with (model / "points3D.bin").open("wb") as file:
        file.write(np.uint64(points).tobytes() + record.tobytes())
    camera = np.array([1, 1], "<i4").tobytes() + np.array(SIZE, "<u8").tobytes()
    lens = np.array([500, 500, SIZE[0] / 2, SIZE[1] / 2], "<f8").tobytes()
    (model / "cameras.bin").write_bytes(np.uint64(1).tobytes() + camera + lens)
    from scipy.spatial.transform import Rotation

    poses = grid_poses(count)
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    with (model / "images.bin").open("wb") as file:
        file.write(np.uint64(count).tobytes())
        for k in range(count):
            name = f"{k:05d}.jpg"
            os.link(folder / "photo.jpg", photos / name)
            observed = np.zeros(seen, OBSERVATION)
            observed["id"] = rng.integers(0, inside, seen)
            file.write(np.uint32(k + 1).tobytes())
            file.write(np.concatenate([turns[k], poses[k, :3, 3]]).astype("<f8").tobytes())
            file.write(np.uint32(1).tobytes() + name.encode() + b"\0")
            file.write(np.uint64(seen).tobytes() + observed.tobytes())


def main() -> int:
    """Write missing scenes, select photos in each, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder to work in")
    parser.add_argument("--photos", type=int, nargs="+", default=[2500, 5000, 20000])
    parser.add_argument("--points", type=int, default=5_000_000, help="sparse points")
    parser.add_argument("--seen", type=int, default=200, help="points that a photo observes")
    parser.add_argument("--methods", nargs="+", default=["coverage"])
    args = parser.parse_args()
    rows = []
    for count in args.photos:
        scene = args.folder / f"{count}-{args.points}-{args.seen}"
        if not scene.exists():
            write_scene(scene, count, args.points, args.seen)
        for method in args.methods:
            command = [sys.executable, "-m", "roigs_engine", "select", str(scene), "--roi", BOX]
            started = time.monotonic()
            with (args.folder / "output.txt").open("w", encoding="utf-8") as output:
                child = subprocess.Popen([*command, "--method", method], stdout=output)
                _, status, usage = os.wait4(child.pid, 0)
            seconds = time.monotonic() - started
            cpu = usage.ru_utime + usage.ru_stime
            peak = usage.ru_maxrss / 1024 / (1024 if sys.platform == "darwin" else 1)
            rows.append((f"{count:,}", method, f"{seconds:.1f}", f"{cpu:.1f}", f"{peak:.0f}"))
            print(*rows[-1], "" if status == 0 else "FAILED", flush=True)
    head = ("photos", "method", "seconds", "CPU seconds", "peak, MiB")
    print("\n".join(table(head, rows, names=2)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
