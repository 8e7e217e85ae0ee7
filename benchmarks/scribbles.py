"""Quality of masks that `masks` makes from one person's scribble, against true masks.

    python demo/masks.py --out true
    python -m benchmarks.scribbles demo/scene --truth true --model runs/demo/result.ply

For each box, strokes as a person would draw them are simulated on one of its close-ups, from the
true mask: three short lines on the object, and one around it. `masks` then makes the masks of the
other photos that are selected for the box. Where only some photos have true masks, as those of a
real scene that were drawn by hand, masks are made of these photos too, and compared on them.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.markdown import table
from roigs_engine.colmap.project import load_colmap
from roigs_engine.formats.scribbles import (
    BACKGROUND,
    OBJECT,
    Scribble,
    Stroke,
    read_scribbles,
)
from roigs_engine.masking.box_masks import masked_photos
from roigs_engine.model.roi import OrientedBox, load_rois
from roigs_engine.photos.mask_images import load_object_mask
from roigs_engine.photos.mask_paths import MaskOptions
from roigs_engine.selection import SelectionConfig, select_cameras

Mask = NDArray[np.bool_]
Scribbles = list[Scribble]
LINES = 3
# In units of the object's size: width of strokes; of the one around it, distance and inexactness.
WIDTH, AWAY, WOBBLE = 0.04, 0.12, 0.01
DEEP = 0.3  # least distance of lines from the outline, in units of the largest distance
LEAST, MOST = 0.25, 0.9  # length of lines, in units of the object's size


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="COLMAP project with rois.json")
    parser.add_argument("--truth", type=Path, required=True, help="folder of true masks")
    parser.add_argument("--model", type=Path, help="PLY of the trained scene")
    parser.add_argument("--seeds", type=int, default=3, help="scribbles for each box (default: 3)")
    parser.add_argument(
        "--scribbles", type=Path, metavar="FILE", help="a person's strokes, not simulated ones"
    )
    parser.add_argument("--box", action="append", default=[], help="only this box; repeatable")
    parser.add_argument("--out", type=Path, help="folder for the masks and pictures of them")
    return parser.parse_args()


def read(path: Path) -> Mask:
    """Read the mask in a file."""
    mask: Mask = np.asarray(Image.open(path).convert("L")) > 127
    return mask


def iou(a: Mask, b: Mask) -> float:
    """Intersection over union of two masks."""
    return float((a & b).sum()) / max(1, int((a | b).sum()))


def strokes(mask: Mask, seed: int) -> tuple[Stroke, ...]:
    """Simulate a person's strokes: lines on an object, and an inexact line around it."""
    rng = np.random.default_rng(seed)
    size = float(np.sqrt(mask.sum()))
    width = max(2.0, WIDTH * size)
    away = cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    deep = away > DEEP * away.max()
    places = np.argwhere(deep)[:, ::-1] + 0.5
    found: list[Stroke] = []
    while len(found) < LINES:
        a, b = places[rng.integers(len(places), size=2)]
        line = a + (b - a) * np.linspace(0, 1, 50)[:, None]
        x, y = line.astype(int).T
        if LEAST * size < np.linalg.norm(b - a) < MOST * size and deep[y, x].all():
            found.append(Stroke(kind=OBJECT, width=width, points=np.array([a, b])))
    beside = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5) <= AWAY * size
    outlines, _ = cv2.findContours(
        beside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    ring = max(outlines, key=len)[:, 0] + 0.5
    ring = ring[:: max(1, len(ring) // 40)]
    ring = np.concatenate([ring, ring[:1]])
    ring = ring + rng.normal(0, WOBBLE * size, ring.shape)
    return (*found, Stroke(kind=BACKGROUND, width=width, points=ring))


def true_masks(roi: OrientedBox, photos: Sequence[str], truth: Path) -> dict[str, Mask]:
    """Photo -> true mask, for photos that have one; the largest masks first."""
    files = {name: truth / roi.name / f"{name}.png" for name in photos}
    masks = {name: read(file) for name, file in files.items() if file.is_file()}
    return dict(sorted(masks.items(), key=lambda pair: -pair[1].sum()))


def scribbles_of(args: argparse.Namespace, box: str, true: dict[str, Mask], seed: int) -> Scribbles:
    """A person's scribbles, or a simulated one on a photo with a true mask."""
    if args.scribbles:
        return [each for each in read_scribbles(args.scribbles) if each.box == box]
    first = list(true)[seed % len(true)]
    return [Scribble(box=box, photo=first, strokes=strokes(true[first], seed))]


def overlay(photo: Path, mask: Mask, truth: Mask, file: Path) -> None:
    """Write the photo with its mask in magenta, and wrong pixels in yellow."""
    pixels = np.asarray(Image.open(photo).convert("RGB")).astype(float)
    pixels[mask] = 0.5 * pixels[mask] + (127, 0, 127)
    pixels[mask != truth] = (255, 255, 0)
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels.astype(np.uint8)).save(file)


def scribbles_document(scribbles: Sequence[Scribble]) -> str:
    """The text of a file of scribbles."""
    records = [
        {
            "box": scribble.box,
            "photo": scribble.photo,
            "strokes": [
                {"kind": s.kind, "width": s.width, "points": np.round(s.points, 2).tolist()}
                for s in scribble.strokes
            ],
        }
        for scribble in scribbles
    ]
    return json.dumps({"scribbles": records}, ensure_ascii=False) + "\n"


def measure(args: argparse.Namespace, roi: OrientedBox, seed: int, out: Path) -> list[str]:
    """Measure one scribble of one box; returns a row of the table."""
    from roigs_engine.cli import main as engine

    scene = load_colmap(args.scene, pixels=False, masks=MaskOptions(used=False))
    selection = select_cameras(scene, roi, SelectionConfig())
    true = true_masks(roi, selection.names, args.truth)
    if len(true) < len(selection.names):  # in a real scene, a few masks drawn by hand
        true = true_masks(roi, [image.name for image in scene.images], args.truth)
    scribbles = scribbles_of(args, roi.name, true, seed)
    drawn = [scribble.photo for scribble in scribbles]
    names = masked_photos(selection.names, selection.candidates, drawn)
    out.mkdir(parents=True, exist_ok=True)
    (out / "scribbles.json").write_text(scribbles_document(scribbles))
    line = ["masks", str(args.scene), "--rois", str(args.scene / "rois.json"), "--box", roi.name]
    line += ["--scribbles", str(out / "scribbles.json"), "--out", str(out)]
    line += ["--model", str(args.model)] if args.model else []
    for name in dict.fromkeys([*names, *true]):
        line += ["--photo", name]
    started = time.monotonic()
    assert engine(line) == 0
    seconds = time.monotonic() - started
    found = {name: read(out / roi.name / f"{name}.png") for name in true}
    for name, mask in found.items():
        picture = out / "pictures" / roi.name / f"{name.replace('/', '-')}.png"
        overlay(args.scene / "images" / name, mask, true[name], picture)
    scores = {name: iou(mask, true[name]) for name, mask in found.items()}
    others = [name for name in scores if name not in drawn]
    there = [f"{scores[name]:.3f}" for name in drawn if name in scores]
    row = [roi.name, ", ".join(drawn), ", ".join(there), str(len(others))]
    row += [f"{reduced([scores[name] for name in others]):.3f}" for reduced in (np.mean, np.min)]
    return [*row, silhouettes(args, roi, out, others) if args.model else "", f"{seconds:.0f}"]


def silhouettes(
    args: argparse.Namespace,
    roi: OrientedBox,
    out: Path,
    photos: Sequence[str],
) -> str:
    """IoU of silhouettes with the true masks, of the object that `cut` cuts out by the masks."""
    from roigs_engine.cli import main as engine
    from roigs_engine.model.gaussians import SH_C0, Gaussians
    from roigs_engine.model.local_frame import LocalFrame
    from roigs_engine.rasterize.view import render_view

    rois = str(args.scene / "rois.json")
    line = ["cut", str(args.scene), "--rois", rois, "--box", roi.name, "--masks", str(out)]
    assert engine([*line, "--model", str(args.model), "--out", str(out / "cut")]) == 0
    masks = MaskOptions(folder=args.truth, used=False, boxes=(roi.name,))
    scene = load_colmap(args.scene, masks=masks)
    frame = LocalFrame.of_scene(scene)
    parts = [
        Gaussians.load_ply(path, frame)
        for path in (out / "cut/rois" / f"{roi.name}.ply", out / "cut/background.ply")
    ]
    for part, value in zip(parts, (0.5, -0.5), strict=True):
        part.sh.zero_()
        part.sh[:, 0] = value / SH_C0
    model, scores = Gaussians.concatenate(parts), []
    for image in frame.scene(scene).images:
        true = load_object_mask(image, roi.name) if image.name in photos else None
        if true is not None:
            shown = render_view(model, image.camera, image.world_to_camera).image[..., 0] > 0.5
            scores.append(iou(shown.numpy(), true))
    return f"{np.mean(scores):.3f}"


def main() -> None:
    """Measure all boxes."""
    args = arguments()
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        for roi in load_rois(args.scene / "rois.json"):
            if args.box and roi.name not in args.box:
                continue
            for seed in range(1 if args.scribbles else args.seeds):
                out = Path(args.out or temporary) / f"{roi.name}-{seed}"
                rows.append(measure(args, roi, seed, out))
                print(" | ".join(rows[-1]), flush=True)
    head = ["box", "scribble on", "IoU there", "other photos", "mean IoU", "worst", "cut", "s"]
    print(*table(head, rows, names=2), sep="\n")


if __name__ == "__main__":
    main()
