"""`compose`: replace a scene's Gaussians in boxes by those of object models."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import ConfigError, RoiError
from ..formats.text import counted
from .console import Console
from .options import add_roi_options, boxes
from .out_folder import refuse_inputs
from .values import NAME, PATH, named_file

HELP = "replace a scene's Gaussians in the boxes by those of object models"
EXAMPLES = """\
  python -m roigs_engine compose scene.ply --rois rois.json --object vase=vase.ply --out all.ply"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("scene_ply", type=PATH, help="PLY of the whole scene")
    add_roi_options(parser)
    parser.add_argument(
        "--object",
        action="append",
        required=True,
        type=NAME,
        metavar="ROI=FILE.ply",
        help="PLY whose Gaussians in the box replace the scene's; repeatable",
    )
    parser.add_argument("--out", type=PATH, required=True, metavar="FILE", help="PLY to write")


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Read the models, merge them and write the result."""
    from ..model.gaussians import Gaussians
    from ..model.operations import merge

    by_name = {roi.name: roi for roi in boxes(args)}
    objects: dict[str, Path] = {}
    for text in args.object:
        name, path = named_file("--object", text, "ROI=FILE.ply")
        if name not in by_name:
            raise RoiError(
                f"--object {text} does not name a box.",
                f"Write ROI=FILE.ply; the boxes are: {', '.join(by_name)}.",
            )
        if name in objects:
            raise RoiError(f"--object names '{name}' twice.", "Give one file for each box.")
        objects[name] = path
    if args.out.suffix.lower() != ".ply":
        raise ConfigError(f"--out {args.out} is not the name of a PLY.", "Write FILE.ply.")
    refuse_inputs([args.out], [args.scene_ply, *objects.values()])
    scene, frame = Gaussians.load_framed(args.scene_ply, scaled=False)
    pairs = [
        (frame.box(by_name[name]), Gaussians.load_ply(path, frame))
        for name, path in objects.items()
    ]
    for (roi, model), path in zip(pairs, objects.values(), strict=True):
        if not model.in_box(roi).any():
            raise RoiError(
                f"{path} has no Gaussian in box '{roi.name}'.", "Is it from the same scene?"
            )
    composed = merge(scene, pairs)
    composed.save_ply(args.out, frame)
    console.print(f"{counted(len(composed), 'Gaussian')} in {args.out}")
    return {"result": str(args.out)}
