"""Objects by masks: `python -m benchmarks.object_masks TRUE RUN ...`; see README.md.

TRUE has the true masks of all photos, as `demo/masks.py` writes them. Compares the objects of
finished runs with the masks that the run did not have. Prints a table.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.markdown import table
from roigs_engine.colmap.project import load_colmap
from roigs_engine.formats import run_files
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.scene import PosedImage
from roigs_engine.photos.decode import load_photo
from roigs_engine.photos.mask_images import load_object_mask
from roigs_engine.photos.mask_paths import MaskOptions
from roigs_engine.rasterize.view import rasterize_view

LEAST = 1024  # pixels of a true mask; photos with fewer are left out
LARGE = 10_000  # pixels from which a photo is a close-up
FINE = 4  # factor on the width and height of a finer picture, to reduce the rasterizer's blur
HEAD = ("run", "box", "close-ups", "IoU", "least", "wide", "IoU", "least", f"IoU, {FINE} x finer")
HEAD_PSNR = ("test photos", "whole (dB)", "object on black", "object on the rest")


@dataclass(frozen=True, kw_only=True)
class View:
    """A photo for which the run had no mask.

    Attributes:
        pixels: number of pixels of the true mask.
        iou: IoU of the object's silhouette with the true mask.
        fine: the same for a silhouette that is drawn finer; None: a close-up.
        psnr: on the true mask's pixels: of the whole model, of the object on black, of the object
            on a picture of the rest; None: it is not a test photo.
    """

    pixels: int
    iou: float
    fine: float | None
    psnr: tuple[float, float, float] | None


def drawn(model: Gaussians, image: PosedImage, times: int = 1) -> tuple[Tensor, Tensor]:
    """Render on black: picture (H, W, 3) and alpha (H, W), at `times` the size and averaged."""
    camera, black = image.camera, torch.zeros(3)
    fine = camera.resized(camera.width * times, camera.height * times)
    with torch.no_grad():
        view = rasterize_view(model, fine, image.world_to_camera, background=black)
    alpha = torch.nn.functional.avg_pool2d(view.alpha, times)[0]
    return view.image[0].clamp(0, 1), alpha


def overlap(alpha: Tensor, mask: Tensor) -> float:
    """Intersection over union of a silhouette and a mask."""
    shown = alpha > 0.5
    return float((shown & mask).sum() / (shown | mask).sum())


def psnr(picture: Tensor, photo: Tensor, mask: Tensor) -> float:
    """PSNR on the mask's pixels, dB."""
    return float(-10 * torch.log10((picture - photo)[mask].square().mean()))


def views(run: Path, true: Path, box: str) -> Iterator[View]:
    """Measure photos that show the box's object, but for which the run had no mask."""
    settings = json.loads((run / run_files.SETTINGS).read_text("utf-8"))
    split = json.loads((run / run_files.SPLIT).read_text("utf-8"))
    manifest = json.loads((run / run_files.MANIFEST).read_text("utf-8"))
    used = manifest.get("object_masks", {}).get(box, {})
    scene = load_colmap(
        Path(settings["scene"]),
        images=settings.get("images"),
        max_side=settings.get("max_side"),
        masks=MaskOptions(folder=true, used=False, boxes=(box,)),
    )
    frame = LocalFrame.of_scene(scene)
    whole = Gaussians.load_ply(run / run_files.RESULT, frame)
    part = Gaussians.load_ply(run / run_files.FINE / f"{box}.ply", frame)
    others = [run / run_files.FINE / f"{name}.ply" for name in boxes(run) if name != box]
    files = [run / run_files.BACKGROUND, *others]
    rest = Gaussians.concatenate([Gaussians.load_ply(file, frame) for file in files])
    for image in frame.scene(scene).images:
        found = load_object_mask(image, box)
        if found is None or found.sum() < LEAST or image.name in used:
            continue
        mask = torch.from_numpy(np.ascontiguousarray(found))
        picture, alpha = drawn(part, image)
        scores = None
        if image.name in split["test"]:
            photo = torch.from_numpy(load_photo(image)).float() / 255
            behind = picture + (1 - alpha[..., None]) * drawn(rest, image)[0]
            uncut = drawn(whole, image)[0]
            scores = (
                psnr(uncut, photo, mask),
                psnr(picture, photo, mask),
                psnr(behind, photo, mask),
            )
        pixels = int(mask.sum())
        fine = overlap(drawn(part, image, FINE)[1], mask) if pixels < LARGE else None
        yield View(pixels=pixels, iou=overlap(alpha, mask), fine=fine, psnr=scores)


def row(run: Path, true: Path, box: str) -> list[str]:
    """The table's row for a run and a box."""
    found = list(views(run, true, box))
    cells = [run.name, box]
    for large in (True, False):
        values = [view.iou for view in found if (view.pixels >= LARGE) == large]
        texts = [f"{np.mean(values):.3f}", f"{min(values):.3f}"] if values else ["", ""]
        cells += [str(len(values)), *texts]
    fine = [view.fine for view in found if view.fine is not None]
    scores = [view.psnr for view in found if view.psnr is not None]
    cells += [f"{np.mean(fine):.3f}" if fine else "", str(len(scores))]
    if not scores:
        return [*cells, "", "", ""]
    whole, black, rest = np.mean(scores, axis=0)
    return [*cells, f"{whole:.2f}", f"{black - whole:+.2f}", f"{rest - whole:+.2f}"]


def boxes(run: Path) -> Sequence[str]:
    """The boxes of a run."""
    return sorted(path.stem for path in (run / run_files.FINE).glob("*.ply"))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("true", type=Path, help="folder of true masks, BOX/PHOTO.png")
    parser.add_argument("runs", type=Path, nargs="+", help="run folders")
    given = parser.parse_args()
    rows = [row(run, given.true, box) for run in given.runs for box in boxes(run)]
    print("\n".join(table((*HEAD, *HEAD_PSNR), rows, names=2)), flush=True)


if __name__ == "__main__":
    main()
