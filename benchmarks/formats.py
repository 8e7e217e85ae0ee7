"""File formats: `python -m benchmarks.formats PLY SCENE [--max-side PX]`; see README.md.

Writes the PLY in every format, reads it back and compares its pictures with those of the PLY, from
cameras of its scene. With npm's splat-transform on the PATH, that program reads what it can, and
its pictures are compared too. Prints a table.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from torch import Tensor

from benchmarks.markdown import table
from roigs_engine.app.conversion.axes import turned
from roigs_engine.colmap.project import load_colmap
from roigs_engine.exchange import formats
from roigs_engine.exchange.arrays import Arrays, turn
from roigs_engine.formats.splat_ply import read_ply
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import PosedImage
from roigs_engine.rasterize.instances import Instance, render_instances

PHOTOS = 6
HEAD = ("format", "MB", "of the PLY", "seconds", "PSNR, dB", "lowest", "splat-transform, dB")
TOOL = "splat-transform"
ITS = (".compressed.ply", ".spz", ".sog", ".splat")
"""Formats that splat-transform reads."""


def pictures(arrays: Arrays, photos: list[PosedImage]) -> list[Tensor]:
    """Render the model from the photos' cameras, on black."""
    gaussians, frame = Gaussians.framed(arrays)
    model = Instance(gaussians=gaussians, frame=frame, matrix=np.eye(4))
    layers = [render_instances([model], photo.camera, photo.world_to_camera) for photo in photos]
    return [layer.image * layer.alpha[..., None] for layer in layers]


def compared(arrays: Arrays, photos: list[PosedImage], wanted: list[Tensor]) -> list[float]:
    """PSNR of each picture, dB."""
    found = pictures(arrays, photos)
    errors = (float((a - b).square().mean()) for a, b in zip(found, wanted, strict=True))
    return [float(-10 * np.log10(error + 1e-12)) for error in errors]


def foreign(path: Path, folder: Path) -> Arrays | None:
    """Read a file with splat-transform; None if it is not installed, or cannot read the format."""
    if shutil.which(TOOL) is None or not path.name.endswith(ITS):
        return None
    back = folder / "foreign.ply"
    subprocess.run([TOOL, "-q", "-w", path, back], check=True, capture_output=True)
    found = read_ply(back)
    return turned(found, turn("y", "-y")) if path.suffix == ".spz" and as_ply() else found


def as_ply() -> bool:
    """Whether splat-transform reads SPZ with a PLY's axes, as it does from version 3 on."""
    said = subprocess.run([TOOL, "--version"], check=True, capture_output=True, text=True)
    version = re.search(r"v(\d+)\.", said.stdout + said.stderr)
    return version is not None and int(version[1]) >= 3


def rows(whole: Path, photos: list[PosedImage], folder: Path) -> list[tuple[str, ...]]:
    """The table's rows of a model."""
    arrays = read_ply(whole)
    wanted, size = pictures(arrays, photos), whole.stat().st_size
    found: list[tuple[str, ...]] = []
    for form in formats.FORMATS:
        if form.suffix in (".ply", ".usda", ".usdz"):
            continue
        path = folder / f"model{form.suffix}"
        there = turn("-y", form.up)
        start = time.monotonic()
        formats.write(path, turned(arrays, there))
        seconds = time.monotonic() - start
        scores, others = "", ""
        lowest = ""
        if form.reads:
            values = compared(turned(formats.read(path), there.T), photos, wanted)
            scores, lowest = f"{np.mean(values):.1f}", f"{min(values):.1f}"
        other = foreign(path, folder)
        if other is not None:
            others = f"{np.mean(compared(other, photos, wanted)):.1f}"
        made = path.stat().st_size
        row = (
            f"{made / 1e6:.1f}",
            f"1/{size / made:.1f}",
            f"{seconds:.0f}",
            scores,
            lowest,
            others,
        )
        found.append((f"{form.title} `{form.suffix}`", *row))
        print(*found[-1], flush=True)
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("ply", type=Path, help="a trained model")
    parser.add_argument("scene", type=Path, help="its COLMAP project")
    parser.add_argument("--max-side", type=int, default=640, help="of the pictures, px")
    given = parser.parse_args()
    scene = load_colmap(given.scene, max_side=given.max_side, pixels=False)
    photos = list(scene.images[:: max(1, len(scene.images) // PHOTOS)][:PHOTOS])
    with tempfile.TemporaryDirectory() as folder:
        found = rows(given.ply, photos, Path(folder))
    count, size = len(read_ply(given.ply)["means"]), given.ply.stat().st_size / 1e6
    print(f"\n{count:,} Gaussians, {size:.1f} MB as PLY, {len(photos)} pictures\n")
    print("\n".join(table(HEAD, found, names=1)), flush=True)


if __name__ == "__main__":
    main()
