"""`refine-cameras`: cameras that fit the model's tracks better; photos are not read."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..colmap.project import find_model
from ..colmap.refine import Refinement, refine_cameras
from ..formats.refined_model import refined_folder
from ..formats.text import counted
from .console import Console
from .values import PATH

HELP = "fit the cameras of a COLMAP model better, which makes everything trained with them sharper"
EXAMPLES = """\
  python -m roigs_engine refine-cameras garden
  python -m roigs_engine refine-cameras garden --out garden-refined"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "scene",
        type=PATH,
        help="folder with a COLMAP model (sparse/0, or the model itself)",
    )
    parser.add_argument(
        "--out",
        type=PATH,
        metavar="DIR",
        help="folder of the new model (default: sparse/refined)",
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Refine the cameras, and say how much better they fit."""
    model = find_model(args.scene, console.context)
    out: Path = args.out or refined_folder(model)
    done = refine_cameras(model, out, console.context)
    console.print(described(done))
    if not done.better:
        return {}
    console.print(
        f"The new model is in {out}. Use this folder as the scene; boxes stay as they are."
    )
    return {"model": str(out)}


def described(done: Refinement) -> str:
    """What the refinement did, in one sentence or two."""
    count = counted(done.left_out, "observation")
    errors = f"{done.before:.2f} -> {done.after:.2f} px, median of {count} left out"
    if not done.better:
        return f"The cameras cannot be made to fit better ({errors}). Nothing is written."
    fuller = f" {counted(done.cameras, 'camera')} got OPENCV's parameters." if done.cameras else ""
    return f"The cameras fit better: {errors}.{fuller}"
