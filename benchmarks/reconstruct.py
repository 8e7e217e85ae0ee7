"""Structure from motion: `python -m benchmarks.reconstruct SCENE ... --out DIR`; see README.md.

Reconstructs SCENE/images and compares the cameras with those of SCENE's own model, which is used
for nothing else. `--colmap` does the same with the settings of COLMAP's automatic reconstructor.
`--mappers` maps the database of our reconstruction with COLMAP's incremental and its global mapper
(GLOMAP), with their own settings; seconds are then of the mapping alone. DIR/NAME has the result;
one that is there is not made again.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.markdown import table
from roigs_engine.colmap.library import pycolmap_module
from roigs_engine.colmap.project import find_model
from roigs_engine.formats.files import read_json, write_json
from roigs_engine.photos.files import PhotoFolder

HEAD = (
    *("photos", "settings", "registered", "points", "error px", "wall s", "CPU s"),
    *("position %, median", "position %, largest"),
)
Vectors = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Row:
    """Measurements of a reconstruction.

    Attributes:
        photos: number of photos in the folder.
        registered: number of photos in the largest model.
        points: number of points.
        error: mean reprojection error, px.
        wall, cpu: seconds.
        median, largest: distance of a camera from its place in the scene's own model, after a
            similarity, in per cent of the cameras' mean distance from their centre.
    """

    photos: int
    registered: int
    points: int
    error: float
    wall: float
    cpu: float
    median: float
    largest: float


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", type=Path, nargs="+", help="folders with images and sparse/0")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--colmap", action="store_true", help="also with COLMAP's settings")
    parser.add_argument("--mappers", action="store_true", help="also COLMAP's two mappers")
    parser.add_argument("--options", default="", help="further options of reconstruct, one string")
    return parser.parse_args()


def automatic(images: Path, out: Path, threads: int) -> None:
    """Reconstruct as COLMAP's automatic reconstructor does for single photos, medium quality."""
    colmap = pycolmap_module("The comparison")
    extraction, matching = colmap.FeatureExtractionOptions(), colmap.FeatureMatchingOptions()
    extraction.max_image_size, extraction.sift.max_num_features = 1600, 4096
    extraction.num_threads = matching.num_threads = threads
    mapping = colmap.IncrementalPipelineOptions()
    mapping.num_threads = threads
    database = out / "database.db"
    colmap.extract_features(database, images, extraction_options=extraction)
    colmap.match_exhaustive(database, matching_options=matching)
    _keep(colmap.incremental_mapping(database, images, out, mapping), out)


def mapped(database: Path, images: Path, out: Path, mapper: str, threads: int) -> None:
    """Run a mapper of COLMAP on a database, with COLMAP's own settings."""
    colmap = pycolmap_module("The comparison")
    kind = {
        "incremental": colmap.IncrementalPipelineOptions,
        "global": colmap.GlobalPipelineOptions,
    }
    options = kind[mapper]()
    options.num_threads, options.random_seed = threads, 0
    _keep(getattr(colmap, f"{mapper}_mapping")(database, images, out, options), out)


def _keep(found: dict[int, Any], out: Path) -> None:
    """Write the largest model into a project's usual folder."""
    best = max(found.values(), key=lambda model: model.num_reg_images())
    (out / "sparse/0").mkdir(parents=True)
    best.write_binary(str(out / "sparse/0"))


def measured(scene: Path, out: Path, words: list[Any]) -> Row:
    """Run Python with these arguments, unless already done, and compare the result in `out`."""
    done = out / "row.json"
    if done.exists():
        return Row(**read_json(done))
    out.mkdir(parents=True, exist_ok=True)
    began, before = time.monotonic(), os.times()
    subprocess.run([sys.executable, *map(str, words)], check=True)
    after = os.times()
    cpu = after.children_user + after.children_system
    cpu -= before.children_user + before.children_system
    row = compared(scene, out, time.monotonic() - began, cpu)
    write_json(done, asdict(row))
    return row


def own_way(scene: Path, out: Path, args: argparse.Namespace) -> list[Any]:
    """The arguments of Python for our reconstruction."""
    words = ["-m", "roigs_engine", "reconstruct", scene / "images", "--out", out]
    return [*words, "--threads", args.threads, *args.options.split()]


def call_of(function: str, *arguments: Path | str | int) -> list[str]:
    """The arguments of Python that call one of this file's functions."""
    values = (f"Path({str(v)!r})" if isinstance(v, Path) else repr(v) for v in arguments)
    name = __spec__.name
    return ["-c", f"from pathlib import *; from {name} import *; {function}({', '.join(values)})"]


def compared(scene: Path, out: Path, wall: float, cpu: float) -> Row:
    """Measure a result."""
    colmap = pycolmap_module("The comparison")
    model = colmap.Reconstruction(str(find_model(out)))
    own = centres(colmap.Reconstruction(str(find_model(scene))))
    found = centres(model)
    both = sorted(own.keys() & found.keys())
    wanted = np.array([own[name] for name in both])
    here = np.array([found[name] for name in both])
    matrix = colmap.estimate_sim3d(here, wanted).matrix()
    off = np.linalg.norm(here @ matrix[:3, :3].T + matrix[:3, 3] - wanted, axis=1)
    off *= 100 / np.linalg.norm(wanted - wanted.mean(axis=0), axis=1).mean()
    return Row(
        photos=len(PhotoFolder(scene / "images").others([])),
        registered=len(found),
        points=model.num_points3D(),
        error=model.compute_mean_reprojection_error(),
        wall=wall,
        cpu=cpu,
        median=float(np.median(off)),
        largest=float(off.max()),
    )


def centres(model: Any) -> dict[str, Vectors]:
    """Name of a photo -> place of its camera."""
    images = model.images.values()
    return {image.name: image.projection_center() for image in images if image.has_pose}


def cells(name: str, settings: str, row: Row) -> list[str]:
    """A row of the table."""
    return [
        *(f"{name} ({row.photos})", settings, str(row.registered), f"{row.points:,}"),
        *(f"{row.error:.2f}", f"{row.wall:.0f}", f"{row.cpu:.0f}"),
        *(f"{row.median:.3f}", f"{row.largest:.3f}"),
    ]


def main() -> None:
    """Reconstruct the scenes one after the other and print the table."""
    args, rows = arguments(), []
    for scene in args.scenes:
        name = scene.resolve().name
        name = scene.resolve().parent.name if name == "scene" else name
        images, own = scene / "images", args.out / name
        ways = {"ours": (own, own_way(scene, own, args))}
        if args.colmap:
            out = args.out / f"{name}-colmap"
            ways["COLMAP's"] = out, call_of("automatic", images, out, args.threads)
        for mapper in ("incremental", "global") if args.mappers else ():
            out = args.out / f"{name}-{mapper}"
            words = call_of("mapped", own / "database.db", images, out, mapper, args.threads)
            ways[f"our matches, {mapper}"] = out, words
        for way, (out, words) in ways.items():
            rows.append(cells(name, way, measured(scene, out, words)))
    sys.stdout.write("\n".join(table(HEAD, rows, names=2)) + "\n")


if __name__ == "__main__":
    main()
