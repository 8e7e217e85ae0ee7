"""Tries the engine in this Python: refines cameras, selects photos, trains, evaluates.

    python tools/try_engine.py

On a made-up scene of a few small photos, with as few steps as can be: some seconds. It shows that
the packages are there and work; the results are worth nothing. Of the first command that fails, the
exit status and the error are passed on.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

SOURCE = Path(__file__).resolve().parent.parent
PHOTOS, POINTS = 8, 150
WIDTH, HEIGHT, FOCAL = 64, 48, 60.0
BOX = {"name": "box", "min": [-0.3, -0.3, -0.3], "max": [0.3, 0.3, 0.3]}


def commands(scene: Path) -> list[list[str]]:
    """Arguments of the engine, for one command after the other."""
    rois = ["--rois", str(scene / "rois.json")]
    few = ["--preset", "draft", "--steps-factor", "0.004", "--device", "cpu"]
    refine = [["refine-cameras", str(scene)]] if importlib.util.find_spec("pycolmap") else []
    return [
        *refine,
        ["select", str(scene), *rois, "--method", "gp9", "--count", "4", "--out", f"{scene}/picks"],
        ["run", str(scene), *rois, *few, "--run-dir", str(scene / "run")],
    ]


def write_scene(folder: Path) -> None:
    """Write a text COLMAP model, photos and a box: coloured points in a cube, from all around."""
    import numpy as np
    from PIL import Image
    from scipy.spatial.transform import Rotation

    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (folder / "images").mkdir()
    random = np.random.default_rng(1)
    points = random.uniform(-0.5, 0.5, (POINTS, 3))
    colours = random.integers(40, 256, (POINTS, 3), np.uint8)
    centre = np.array([WIDTH / 2, HEIGHT / 2])
    images: list[str] = []
    tracks: list[list[str]] = [[] for _ in points]
    for number in range(1, PHOTOS + 1):
        turn = Rotation.from_euler("y", 360 * number / PHOTOS, degrees=True)
        seen = turn.apply(points) + np.array([0, 0.1 * number, 3])
        x, y, z, w = turn.as_quat()
        images.append(f"{number} {w} {x} {y} {z} 0 {0.1 * number} 3 1 {number}.png")
        rays = seen[:, :2] / seen[:, 2:]
        bend = 1 + 0.02 * (rays**2).sum(axis=1, keepdims=True)  # for `refine-cameras`
        pixels = FOCAL * rays * bend + centre
        images.append(" ".join(f"{u} {v} {k}" for k, (u, v) in enumerate(pixels, 1)))
        for place, track in enumerate(tracks):
            track.append(f"{number} {place}")
        photo = np.full((HEIGHT, WIDTH, 3), 30, np.uint8)
        across, down = np.clip(pixels.astype(int).T, 1, [[WIDTH - 1], [HEIGHT - 1]])
        photo[down, across] = photo[down - 1, across] = colours
        Image.fromarray(photo).save(folder / "images" / f"{number}.png")
    _write(model / "cameras.txt", [f"1 SIMPLE_PINHOLE {WIDTH} {HEIGHT} {FOCAL} {WIDTH / 2} 24"])
    _write(model / "images.txt", images)
    rows = zip(points, colours, tracks, strict=True)
    _write(
        model / "points3D.txt",
        [f"{k} {_row(p)} {_row(c)} 0.5 {' '.join(t)}" for k, (p, c, t) in enumerate(rows, 1)],
    )
    _write(folder / "rois.json", [json.dumps({"rois": [BOX]})])


def _row(values: Any) -> str:
    return " ".join(map(str, values))


def _write(path: Path, lines: list[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def run(arguments: list[str], folder: Path) -> int:
    """Run one command of the engine; returns its exit status."""
    done = subprocess.run(
        [sys.executable, "-m", "roigs_engine", *arguments],
        env=os.environ | {"PYTHONPATH": str(SOURCE), "PYTHONSAFEPATH": "1", "PYTHONUTF8": "1"},
        cwd=folder,
        check=False,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        errors="replace",
    )
    if not done.returncode:
        print(f"{arguments[0]}: works")
        return 0
    said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    errors = [line for line in said if line.startswith("error:")]
    reason = (errors or said or [f"error: status {done.returncode}"])[-1].removeprefix("error:")
    print(*said[-20:], f"ERROR: {arguments[0]} does not work: {reason.strip()}", sep="\n")
    return done.returncode


def main() -> int:
    """Run all commands; returns the exit status of the first that fails, or 0."""
    with tempfile.TemporaryDirectory(prefix="roigs-try-") as place:
        scene = Path(place)
        write_scene(scene)
        return next(filter(None, (run(arguments, scene) for arguments in commands(scene))), 0)


if __name__ == "__main__":
    sys.exit(main())
