"""Objects by masks: `python -m benchmarks.object_masks TRUE RUN ... [--cut]`; see README.md.

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
from roigs_engine.photos.mask_files import MaskOptions
from roigs_engine.photos.masks import load_object_mask
from roigs_engine.rasterize.view import rasterize_view

LEAST = 1024  # pixels of a true mask; photos with fewer are left out
LARGE = 10_000  # pixels from which a photo is a close-up
HEAD = ("run", "box", "photos", "close-ups: IoU", "least", "wide: IoU", "least")
HEAD_PSNR = ("object's pixels: uncut (dB)", "alone (dB)", "difference")


@dataclass(frozen=True, kw_only=True)
class View:
    """One photo that the run had no mask of.

    Attributes:
        pixels: of the true mask.
        iou: of the object's silhouette with it.
        uncut, alone: PSNR on its pixels of the whole model and of the object; None: the photo was
            trained on.
    """

    pixels: int
    iou: float
    uncut: float | None
    alone: float | None


def drawn(model: Gaussians, image: PosedImage) -> tuple[Tensor, Tensor]:
    """A picture on black (H, W, 3), and how opaque it is (H, W)."""
    black = torch.zeros(3)
    with torch.no_grad():
        view = rasterize_view(model, image.camera, image.world_to_camera, background=black)
    return view.image[0].clamp(0, 1), view.alpha[0]


def psnr(picture: Tensor, photo: Tensor, mask: Tensor) -> float:
    """On the mask's pixels, dB."""
    return float(-10 * torch.log10((picture - photo)[mask].square().mean()))


def views(run: Path, true: Path, box: str) -> Iterator[View]:
    """The photos that show the box's object, and that the run had no mask of."""
    settings = json.loads((run / run_files.SETTINGS).read_text("utf-8"))
    split = json.loads((run / run_files.SPLIT).read_text("utf-8"))
    manifest = json.loads((run / run_files.MANIFEST).read_text("utf-8"))
    used = manifest.get("object_masks", {}).get(box, {})
    scene = load_colmap(
        Path(settings["scene"]),
        max_side=settings.get("max_side"),
        masks=MaskOptions(folder=true, used=False, boxes=(box,)),
        pixels=False,
    )
    frame = LocalFrame.of_scene(scene)
    whole = Gaussians.load_ply(run / run_files.RESULT, frame)
    part = Gaussians.load_ply(run / run_files.FINE / f"{box}.ply", frame)
    for image in frame.scene(scene).images:
        found = load_object_mask(image, box)
        if found is None or found.sum() < LEAST or image.name in used:
            continue
        mask = torch.from_numpy(np.ascontiguousarray(found))
        picture, alpha = drawn(part, image)
        shown = alpha > 0.5
        scores: tuple[float | None, float | None] = None, None
        if image.name in split["test"]:
            photo = torch.from_numpy(load_photo(image)).float() / 255
            scores = psnr(drawn(whole, image)[0], photo, mask), psnr(picture, photo, mask)
        iou = float((shown & mask).sum() / (shown | mask).sum())
        yield View(pixels=int(mask.sum()), iou=iou, uncut=scores[0], alone=scores[1])


def row(run: Path, true: Path, box: str) -> list[str]:
    """The cells of a run and a box."""
    found = list(views(run, true, box))
    cells = [run.name, box, str(len(found))]
    for large in (True, False):
        values = [view.iou for view in found if (view.pixels >= LARGE) == large]
        cells += [f"{np.mean(values):.3f}", f"{min(values):.3f}"] if values else ["", ""]
    uncut, alone = (
        float(np.mean([getattr(view, key) for view in found if view.uncut is not None]))
        for key in ("uncut", "alone")
    )
    return [*cells, f"{uncut:.2f}", f"{alone:.2f}", f"{alone - uncut:+.2f}"]


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
