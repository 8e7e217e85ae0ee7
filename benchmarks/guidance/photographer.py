"""Photos of the demo's room from any place: `python -m benchmarks.guidance.photographer DIR`.

DIR/shots.json lists photos by name: camera to world (4, 4) with OpenCV axes, in the demo's frame.
Those that DIR/images lacks are rendered, the first ones first; a missing list is made of views to
test with. Needs bpy 4.5, like demo/make_scene.py, whose room and settings these are.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

DEMO = Path(__file__).resolve().parents[2] / "demo"
WIDTH, HEIGHT = 400, 268
SAMPLES, QUALITY = 16, 90
TESTS, VALIDATION = 20, 20  # views of each object
TRIES = 4000
MOST_HIDDEN = 0.25  # share of a test view's object


def room() -> Any:
    """The demo's room in Blender; returns its camera."""
    sys.path.insert(0, str(DEMO))
    camera = import_module("make_scene").prepare(SAMPLES, QUALITY, 0)
    library = import_module("materials").Library()
    render = bpy.data.scenes[0].render
    render.resolution_x, render.resolution_y = WIDTH, HEIGHT
    import_module("room").build_room(library)
    import_module("objects").build_objects(library)
    return camera


def views(seed: int, count: int, truth: dict[str, Any]) -> dict[str, list[list[float]]]:
    """Views of each object that a person may have, half of them near; needs `room`.

    The distance is 1.1 to 4.5 diagonals of the object, even in its logarithm; the object is in
    the picture, not in its middle, and at most partly hidden.
    """
    cameras = import_module("cameras")
    fov = 2 * math.atan(18 / 28), 2 * math.atan(18 / 28 * HEIGHT / WIDTH)
    probe, rng, found = cameras.Probe(fov), np.random.default_rng(seed), {}
    for name, bounds in truth["objects"].items():
        low, high = Vector(bounds["min"]), Vector(bounds["max"])
        size, taken = (high - low).length, 0
        for _ in range(TRIES):
            if taken == count:
                break
            way = rng.normal(size=3)
            way /= np.linalg.norm(way)
            middle = np.array(low + high) / 2
            reach = size * 1.1 * (4.5 / 1.1) ** ((taken + rng.uniform()) / count)
            eye = middle + way * reach
            target = middle + rng.uniform(-0.15, 0.15, 3) * reach * 0.5
            shot = cameras.Shot(f"{name}_{taken:02d}", Vector(eye), Vector(target))
            inside = abs(eye[0]) < 2.5 and abs(eye[1]) < 2.1 and 0.3 < eye[2] < 2.3
            if not inside or not probe.free(shot, 0.17):
                continue
            if probe.hidden(shot, low, high, name) > MOST_HIDDEN:
                continue
            turn = np.array([list(row) for row in shot.matrix()])
            found[f"{shot.name}.jpg"] = (turn @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist()
            taken += 1
    return found


def main() -> None:
    """Render what is missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0, help="of a list that is made")
    parser.add_argument("--count", type=int, default=TESTS, help="views of each object in it")
    args = parser.parse_args()
    camera = room()
    listed = args.folder / "shots.json"
    if not listed.is_file():
        truth = json.loads((DEMO / "scene" / "truth.json").read_text())
        args.folder.mkdir(parents=True, exist_ok=True)
        listed.write_text(json.dumps(views(args.seed, args.count, truth)))
    shots = json.loads(listed.read_text())
    for name, matrix in shots.items():
        path = args.folder / "images" / name
        if path.exists():
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        camera.matrix_world = Matrix((np.array(matrix) @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist())
        part = path.with_name(f"part_{path.name}")
        bpy.data.scenes[0].render.filepath = str(part)
        bpy.ops.render.render(write_still=True)
        part.rename(path)
        print(f"{name} rendered", flush=True)


if __name__ == "__main__":
    main()
