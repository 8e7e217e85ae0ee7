"""The command: tables of all boxes; see the README of benchmarks."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.markdown import table
from roigs_engine.app.run_scene import cameras_of_run
from roigs_engine.context import QUIET
from roigs_engine.formats import run_files
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox, roi_from_dict

from .distances import WITHIN, Scores, Triangles, aligned, compare, seen_truth
from .pictures import Mesh, Picture, load_mesh, pictures

TRUTH = Path("runs/truth")
TRUE_MESHES = Path(__file__).resolve().parents[2] / "demo/meshes.py"
MILLIMETRES = tuple(f"{1000 * distance:.0f}" for distance in WITHIN)
HEAD = (
    *("box", *(f"F {d} mm" for d in MILLIMETRES)),
    *(f"precision {d}" for d in MILLIMETRES),
    *(f"recall {d}" for d in MILLIMETRES),
    *("off, median (mm)", "95 %", "missed, median (mm)", "95 %", "normals (°)", "seen"),
    *("components", "faces", "MB"),
)
PAINTED = ("mesh", "mesh, colours per vertex", "Gaussians")
HEAD_PICTURES = (
    *("box", "photo", "pixels"),
    *(f"PSNR, {what}" for what in PAINTED),
    *(f"FLIP, {what}" for what in PAINTED),
)


def true_surfaces(folder: Path) -> dict[str, Triangles]:
    """The meshes of `demo/meshes.py`; made (needs `bpy`) if the folder does not have them."""
    file = folder / "meshes.npz"
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        subprocess.run([sys.executable, str(TRUE_MESHES), str(file.resolve())], check=True)
    with np.load(file) as arrays:
        return {name: arrays[name] for name in arrays.files}


def row(name: str, scores: Scores, mesh: Mesh, size: int) -> list[str]:
    """The cells of a mesh."""
    shares = (*scores.f, *scores.precision, *scores.recall)
    lengths = (*scores.off, *scores.missed)
    return [
        *(name, *(f"{share:.3f}" for share in shares)),
        *(f"{1000 * length:.2f}" for length in lengths),
        *(f"{scores.normals:.1f}", f"{100 * scores.seen:.0f} %"),
        *(f"{mesh.components:,}", f"{len(mesh.faces):,}", f"{size / 1e6:.1f}"),
    ]


def picture_rows(name: str, found: Sequence[Picture]) -> list[list[str]]:
    """A row for each photo, and that of their means."""

    def cells(photo: str, pixels: int, psnr: Sequence[float], flip: Sequence[float]) -> list[str]:
        return [
            *(name, photo, f"{pixels:,}", *(f"{value:.2f}" for value in psnr)),
            *("" if np.isnan(value) else f"{value:.3f}" for value in flip),
        ]

    if not found:
        return []
    flips = [[np.nan if value is None else value for value in one.flip] for one in found]
    rows = [
        cells(one.name, one.pixels, one.psnr, flip) for one, flip in zip(found, flips, strict=True)
    ]
    psnr = np.mean([one.psnr for one in found], axis=0)
    pixels = sum(one.pixels for one in found)
    return [*rows, cells("mean", pixels, psnr, np.mean(flips, axis=0))]


def models_of(run: Path, box: str) -> tuple[Gaussians, Gaussians]:
    """The whole result of a run, and the part of it that is not in the box."""
    others = [path for path in (run / run_files.FINE).glob("*.ply") if path.stem != box]
    parts = [Gaussians.load_ply(path) for path in (run / run_files.BACKGROUND, *sorted(others))]
    return Gaussians.load_ply(run / run_files.RESULT), Gaussians.concatenate(parts)


def boxes_of(run: Path) -> dict[str, OrientedBox]:
    """The boxes of a run by name."""
    manifest = json.loads((run / run_files.MANIFEST).read_text("utf-8"))
    return {record["name"]: roi_from_dict(record) for record in manifest["rois"]}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("run", type=Path, help="finished run of the demo")
    parser.add_argument(
        *("--mesh", "-m"), action="append", default=[], metavar="BOX=FILE", help="a box's mesh"
    )
    parser.add_argument("--scene", type=Path, help="its scene, if that was moved")
    parser.add_argument("--aligned", action="store_true", help="move each mesh onto the truth")
    parser.add_argument("--no-pictures", action="store_true", help="without test photos")
    parser.add_argument(
        "--truth", type=Path, default=Path("runs/truth"), help="folder to keep the truth in"
    )
    parser.add_argument("--out", type=Path, help="JSON of all that was measured")
    given = parser.parse_args()
    scene = cameras_of_run(given.run, given.scene, QUIET)
    boxes, surfaces = boxes_of(given.run), true_surfaces(given.truth)
    meshes = dict(text.split("=", 1) for text in given.mesh) or {
        name: str(given.run / run_files.FINE / f"{name}.glb") for name in boxes
    }
    measured, rows, shown = {}, [], []
    test = json.loads((given.run / run_files.SPLIT).read_text("utf-8"))["test"]
    for name, file in meshes.items():
        mesh, true = load_mesh(Path(file), boxes[name]), surfaces[name]
        rest = np.concatenate([part for key, part in surfaces.items() if key != name])
        truth, seen = seen_truth(true, rest, scene.without(test).images, given.truth)
        made = aligned(mesh.triangles, true) if given.aligned else mesh.triangles
        scores = compare(made, true, truth, seen)
        rows.append(row(name, scores, mesh, Path(file).stat().st_size))
        found: list[Picture] = []
        if not given.no_pictures:
            images = scene.select(test).images
            found = list(pictures(mesh, models_of(given.run, name), images, (true, rest)))
        shown += picture_rows(name, found)
        measured[name] = {**asdict(scores), "pictures": [asdict(picture) for picture in found]}
    print("\n".join(table(HEAD, rows, names=1)))
    if shown:
        print("\n" + "\n".join(table(HEAD_PICTURES, shown, names=2)))
    if given.out:
        given.out.write_text(json.dumps(measured, indent=1), "utf-8")


if __name__ == "__main__":
    main()
