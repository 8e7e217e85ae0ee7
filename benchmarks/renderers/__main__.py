"""Models in the renderers that they are made for: `python -m benchmarks.renderers`; see README.md.

Draws the test photos' cameras with Blender's Cycles or with PlayCanvas in a browser, beside our
renderer, and compares all pictures with the photos. Prints a table, and keeps the pictures.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.markdown import table
from benchmarks.renderers import by_browser, by_cycles
from roigs_engine.colmap.project import load_colmap
from roigs_engine.evaluation.metrics import psnr_from_mse, squared_error, ssim
from roigs_engine.evaluation.scores import MIN_SILHOUETTE
from roigs_engine.formats import run_files
from roigs_engine.formats.targets import VIEWERS
from roigs_engine.kernels import library
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.roi import load_rois
from roigs_engine.model.scene import PosedImage, SfmScene
from roigs_engine.photos.decode import load_photo
from roigs_engine.rasterize.view import render_view

HEAD = ("made for", "drawn by", "photos", "PSNR, dB", "SSIM", "boxes, dB", "without noise, dB")


@dataclass(frozen=True, kw_only=True)
class Score:
    """One picture against its photo: mean squared errors, of all and of the boxes; SSIM.

    Attributes:
        noise: the part of `error` that more samples would remove.
        box: None: the photo hardly shows a box.
    """

    photo: str
    error: float
    ssim: float
    box: float | None
    noise: float = 0.0


def score(picture: Tensor, image: PosedImage, boxes: Tensor, noise: float = 0.0) -> Score:
    """`picture` and its photo; `boxes` (H, W) are the pixels of the boxes."""
    photo = torch.from_numpy(load_photo(image))
    error = squared_error(picture, photo.float() / 255)
    return Score(
        photo=image.name,
        error=float(error.mean()),
        ssim=ssim(picture, photo, torch.ones_like(boxes)),
        box=float(error[boxes].mean()) if int(boxes.sum()) >= MIN_SILHOUETTE else None,
        noise=noise,
    )


def cells(scores: list[Score]) -> list[str]:
    """The numbers of a row: means over photos, of PSNR in dB."""

    def mean(errors: Iterator[float]) -> str:
        return f"{np.mean([psnr_from_mse(error) for error in errors]):.2f}"

    return [
        str(len(scores)),
        mean(s.error for s in scores),
        f"{np.mean([s.ssim for s in scores]):.4f}",
        mean(s.box for s in scores if s.box is not None),
        mean(s.error - s.noise for s in scores) if any(s.noise for s in scores) else "",
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Cameras:
    """The test photos of a run: as in the world, and in the frame that our renderer draws in."""

    world: SfmScene
    local: SfmScene
    frame: LocalFrame
    boxes: dict[str, Tensor]


def cameras_of(run: Path, scene: Path, side: int, out: Path, every: int) -> Cameras:
    """Every n-th test photo of a run, undistorted, at a size."""
    split = json.loads((run / run_files.SPLIT).read_text("utf-8"))
    names = sorted(split[split["evaluate_on"]])[::every]
    whole = load_colmap(scene, cache=out / "photos", max_side=side)
    frame, rois = LocalFrame.of_scene(whole), load_rois(scene / "rois.json")
    world = whole.select(names)
    boxes = {
        image.name: torch.from_numpy(
            np.any([roi.silhouette(image.camera, image.world_to_camera) for roi in rois], axis=0)
        )
        for image in world.images
    }
    return Cameras(world=world, local=frame.scene(world), frame=frame, boxes=boxes)


def model_of(path: Path, cameras: Cameras) -> Gaussians:
    """A run's result, or a PLY."""
    ply = path / run_files.RESULT if path.is_dir() else path
    return Gaussians.load_ply(ply, cameras.frame)


def ours(model: Gaussians, cameras: Cameras) -> list[Score]:
    """Drawn by our renderer."""
    return [
        score(
            render_view(model, image.camera, image.world_to_camera).image,
            image,
            cameras.boxes[image.name],
        )
        for image in cameras.local.images
    ]


def parse() -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("renderer", choices=("cycles", "browser"))
    parser.add_argument("scene", type=Path, help="COLMAP project with rois.json")
    parser.add_argument("model", type=Path, help="run folder, or PLY, made for the renderer")
    parser.add_argument("--beside", type=Path, required=True, help="run folder, made for viewers")
    parser.add_argument("--program", required=True, help="Blender's Python, or a Chromium")
    parser.add_argument("--out", type=Path, required=True, help="folder of the pictures")
    parser.add_argument("--max-side", type=int, default=320, help="of the pictures, px")
    parser.add_argument("--samples", type=int, default=128, help="of Cycles, of each pixel")
    parser.add_argument("--every", type=int, default=1, help="take every n-th test photo")
    parser.add_argument("--threads", type=int, default=1)
    return parser.parse_args()


def main() -> None:
    """Print the table."""
    given = parse()
    library.set_threads(given.threads)
    torch.set_num_threads(given.threads)
    cameras = cameras_of(given.beside, given.scene, given.max_side, given.out, given.every)
    best, model = model_of(given.beside, cameras), model_of(given.model, cameras)
    if best.target != VIEWERS:
        raise SystemExit(f"error: {given.beside} is not made for viewers.")
    draw: Callable[..., Iterator[tuple[str, Tensor, float]]] = (
        by_cycles.pictures if given.renderer == "cycles" else by_browser.pictures
    )
    rows = {("viewers", "ours"): ours(best, cameras)}
    rows[model.target.name, "ours"] = ours(model, cameras)
    found = []
    for name, picture, noise in draw(given, cameras.world):
        image = cameras.world.image(name)
        found.append(score(picture, image, cameras.boxes[name], noise))
        print(name, *cells(found[-1:])[1:], flush=True)
    rows[model.target.name, given.renderer] = found
    record = {"/".join(key): [asdict(s) for s in scores] for key, scores in rows.items()}
    (given.out / f"{given.renderer}.json").write_text(json.dumps(record, indent=1))
    print("\n".join(table(HEAD, [[*key, *cells(s)] for key, s in rows.items()], names=2)))


if __name__ == "__main__":
    main()
