"""Trained objects from photos alone: `python -m benchmarks.from_photos SCENE ... --out DIR`.

Trains the preset `draft` on DIR/NAME, which `benchmarks.reconstruct` has made of SCENE/images, and
on SCENE's own model, with SCENE's boxes in both. Prints the PSNR of the boxes on the same test
photos. See README.md.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.markdown import table
from benchmarks.reconstruct import Vectors, centres
from roigs_engine.colmap.library import pycolmap_module
from roigs_engine.colmap.project import find_model
from roigs_engine.formats.files import read_json, write_json
from roigs_engine.formats.rois import RoiRecord, read_rois

EVERY = 8  # every 8th photo that both models have is a test photo
HEAD = ("box", "test photos", "own model, dB", "from photos, dB", "difference")


def moved(box: RoiRecord, matrix: Vectors) -> dict[str, Any]:
    """Transform a box by a similarity (4, 4)."""
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    rotation, offset = matrix[:3, :3] / scale, matrix[:3, 3]
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = rotation.T, -rotation.T @ offset
    grown = box.world_to_box.copy()
    grown[:3, 3] *= scale
    return {
        "name": box.name,
        "world_to_box": (grown @ back).tolist(),
        "half_extents": (box.half_extents * scale).tolist(),
    }


def registered(project: Path) -> dict[str, Vectors]:
    """Name of a photo -> place of its camera."""
    colmap = pycolmap_module("The comparison")
    return centres(colmap.Reconstruction(str(find_model(project))))


def boxes_for(
    scene: Path, own: dict[str, Vectors], found: dict[str, Vectors]
) -> list[dict[str, Any]]:
    """Transform the scene's boxes to another model's frame, by the cameras of both models."""
    both = sorted(own.keys() & found.keys())
    here, there = (np.array([places[name] for name in both]) for places in (own, found))
    matrix = np.eye(4)
    matrix[:3] = pycolmap_module("The comparison").estimate_sim3d(here, there).matrix()
    return [moved(box, matrix) for box in read_rois(scene / "rois.json")]


def trained(
    project: Path, boxes: Path, run: Path, tests: list[str], max_side: int
) -> dict[str, tuple[float, int]]:
    """Train without the test photos; returns box -> mean PSNR in it, and number of test photos."""
    size = ("--max-side", max_side)
    words: list[Any]
    if not (run / "result.ply").exists():
        words = ["train", project, "--rois", boxes, "--run-dir", run, *size]
        words += ["--preset", "draft", "--test-every", 0]
        for name in tests:
            words += ["--exclude", name]
        _engine(words)
    out = run.with_name(f"{run.name}-scores")
    split = run.with_name(f"{run.name}-split.json")
    write_json(split, {"evaluate_on": "test", "test": tests})
    model = f"Ours={run / 'result.ply'}"
    words = ["evaluate", project, "--rois", boxes, "--model", model, "--split", split]
    _engine([*words, "--out", out, *size])
    found = {}
    for roi in read_json(out / "report.json")["rois"]:
        views = roi["rows"][-1]["views"]
        found[roi["roi"]] = float(np.mean([view["roi_psnr"] for view in views])), len(views)
    return found


def _engine(words: list[Any]) -> None:
    subprocess.run([sys.executable, "-m", "roigs_engine", *map(str, words)], check=True)


def main() -> None:
    """Train and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", type=Path, nargs="+", help="folders with images and sparse/0")
    parser.add_argument("--out", type=Path, required=True, help="that of benchmarks.reconstruct")
    parser.add_argument("--max-side", type=int, default=640, help="photos in training, px")
    given = parser.parse_args()
    rows = []
    for scene in given.scenes:
        name = scene.resolve().name
        name = scene.resolve().parent.name if name == "scene" else name
        project, boxes = given.out / name, given.out / f"{name}-rois.json"
        places = [registered(folder) for folder in (scene, project)]
        both = sorted(places[0].keys() & places[1].keys())
        tests = both[EVERY // 2 :: EVERY]
        write_json(boxes, {"rois": boxes_for(scene, *places)})
        run = given.out / f"{name}-run"
        sides = given.max_side
        own = trained(scene, scene / "rois.json", Path(f"{run}-own"), tests, sides)
        found = trained(project, boxes, Path(f"{run}-found"), tests, sides)
        for box, (here, count) in own.items():
            there = found[box][0]
            numbers = (f"{here:.2f}", f"{there:.2f}", f"{there - here:+.2f}")
            rows.append([f"{name}: {box}", str(count), *numbers])
            print(*rows[-1], flush=True)
    print("\n".join(table(HEAD, rows, names=1)))


if __name__ == "__main__":
    main()
