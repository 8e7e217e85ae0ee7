"""File formats: `python -m benchmarks.formats RUN ...`; see README.md.

Writes RUN/result.ply in every format, reads it back and compares its pictures with those of the PLY,
from cameras of the run's scene. With npm's splat-transform on the PATH, that program reads what it
can, and its pictures are compared too. Prints a table.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from torch import Tensor

from benchmarks.markdown import table
from roigs_engine.colmap.project import load_colmap
from roigs_engine.commands.convert import turned
from roigs_engine.exchange import axes, formats
from roigs_engine.exchange.arrays import Arrays
from roigs_engine.formats.files import read_json
from roigs_engine.formats.splat_ply import read_ply
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import PosedImage
from roigs_engine.rasterize.placed import PlacedModel, render_placed

PHOTOS = 6
HEAD = ("format", "MB", "of the PLY", "seconds", "PSNR, dB", "lowest", "splat-transform, dB")
TOOL = "splat-transform"
ITS = (".compressed.ply", ".spz", ".sog", ".splat")
"""What the other program reads."""


def pictures(arrays: Arrays, photos: list[PosedImage]) -> list[Tensor]:
    """The model from the photos' cameras, on black."""
    gaussians, frame = Gaussians.framed(arrays)
    model = PlacedModel(gaussians=gaussians, frame=frame, matrix=np.eye(4))
    layers = [render_placed([model], photo.camera, photo.world_to_camera) for photo in photos]
    return [layer.image * layer.alpha[..., None] for layer in layers]


def compared(arrays: Arrays, photos: list[PosedImage], wanted: list[Tensor]) -> list[float]:
    """PSNR of each picture."""
    found = pictures(arrays, photos)
    errors = (float((a - b).square().mean()) for a, b in zip(found, wanted, strict=True))
    return [float(-10 * np.log10(error + 1e-12)) for error in errors]


def foreign(path: Path, folder: Path) -> Arrays | None:
    """What the other program reads; None where it is not installed or does not read it."""
    if shutil.which(TOOL) is None or not path.name.endswith(ITS):
        return None
    back = folder / "foreign.ply"
    subprocess.run([TOOL, "-q", "-w", path, back], check=True, capture_output=True)
    return read_ply(back)


def rows(run: Path, folder: Path) -> list[tuple[str, ...]]:
    """The rows of a run."""
    config = read_json(run / "manifest.json")["config"]
    scene = load_colmap(Path(config["scene"]), max_side=config["max_side"])
    photos = scene.images[:: max(1, len(scene.images) // PHOTOS)][:PHOTOS]
    whole = run / "result.ply"
    arrays = read_ply(whole)
    wanted, size = pictures(arrays, photos), whole.stat().st_size
    found = []
    for form in formats.FORMATS:
        if form.suffix in (".ply", ".usda", ".usdz"):
            continue
        path = folder / f"model{form.suffix}"
        there = axes.turn("-y", form.up)
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
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="a finished run")
    for run in parser.parse_args().runs:
        with tempfile.TemporaryDirectory() as folder:
            found = rows(run, Path(folder))
        count = len(read_ply(run / "result.ply")["means"])
        size = (run / "result.ply").stat().st_size / 1e6
        print(f"\n{run.name}: {count:,} Gaussians, {size:.1f} MB as PLY\n")
        print("\n".join(table(HEAD, found, names=1)), flush=True)


if __name__ == "__main__":
    main()
