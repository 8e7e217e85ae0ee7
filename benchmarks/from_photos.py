"""Trained objects from photos alone: `python -m benchmarks.from_photos SCENE ... --out DIR`.

Trains the preset `draft` on DIR/NAME, which `benchmarks.reconstruct` has made of SCENE/images, and
on SCENE's own model, with SCENE's boxes in both. Prints the PSNR of the boxes on the test photos
that both have. See README.md.
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

HEAD = ("box", "test photos", "own model, dB", "from photos, dB", "difference")


def moved(box: RoiRecord, matrix: Vectors) -> dict[str, Any]:
    """A box after a similarity (4, 4)."""
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


def boxes_for(scene: Path, project: Path) -> list[dict[str, Any]]:
    """The scene's boxes in the frame of another model of the same photos."""
    colmap = pycolmap_module("The comparison")
    own, found = (centres(colmap.Reconstruction(str(find_model(f)))) for f in (scene, project))
    both = sorted(own.keys() & found.keys())
    here, there = (np.array([places[name] for name in both]) for places in (own, found))
    matrix = np.eye(4)
    matrix[:3] = colmap.estimate_sim3d(here, there).matrix()
    return [moved(box, matrix) for box in read_rois(scene / "rois.json")]


def trained(project: Path, boxes: Path, run: Path, max_side: int) -> dict[str, dict[str, float]]:
    """Box -> test photo -> PSNR in the box."""
    if not (run / "report.json").exists():
        words = ["run", project, "--rois", boxes, "--run-dir", run, "--max-side", max_side]
        words += ["--preset", "draft", "--compare"]
        subprocess.run([sys.executable, "-m", "roigs_engine", *map(str, words)], check=True)
    report = read_json(run / "report.json")
    ours = {roi["roi"]: roi["rows"][-1]["views"] for roi in report["rois"]}
    return {box: {view["view"]: view["roi_psnr"] for view in ours[box]} for box in ours}


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
        project = given.out / name
        boxes = given.out / f"{name}-rois.json"
        write_json(boxes, {"rois": boxes_for(scene, project)})
        own = trained(scene, scene / "rois.json", given.out / f"{name}-own", given.max_side)
        found = trained(project, boxes, given.out / f"{name}-found", given.max_side)
        for box, scores in own.items():
            both = sorted(scores.keys() & found[box].keys())
            here, there = (np.mean([s[view] for view in both]) for s in (scores, found[box]))
            numbers = (f"{here:.2f}", f"{there:.2f}", f"{there - here:+.2f}")
            rows.append([f"{name}: {box}", str(len(both)), *numbers])
            print(*rows[-1], flush=True)
    print("\n".join(table(HEAD, rows, names=1)))


if __name__ == "__main__":
    main()
