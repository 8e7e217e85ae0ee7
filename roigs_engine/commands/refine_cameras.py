"""`refine-cameras`: cameras that fit the photos better."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..colmap.project import find_model
from ..colmap.refine import Refinement, refine_cameras
from ..colmap.refine_by_matches import MatchedFit
from ..formats.projects import refined_folder
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
        "--images", type=PATH, metavar="DIR", help="folder of the photos (default: the project's)"
    )
    parser.add_argument(
        "--tracks-only",
        action="store_true",
        help="use the model's keypoints alone, and do not look at the photos: faster, less exact",
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
    done = refine_cameras(
        model, out, console.context, images=args.images, look=not args.tracks_only
    )
    console.print(described(done))
    if not done.better:
        return {}
    console.print(
        f"The new model is in {out}. Use this folder as the scene; boxes stay as they are."
    )
    return {"model": str(out)}


def described(done: Refinement) -> str:
    """What the refinement did, in a few sentences."""
    return " ".join([_by_tracks(done), *_by_matches(done.matched)])


def _by_tracks(done: Refinement) -> str:
    count = counted(done.left_out, "observation")
    errors = f"{done.before:.2f} -> {done.after:.2f} px, median of {count} left out"
    if not done.fits_tracks_better:
        nothing = "" if done.better else " Nothing is written."
        return f"The cameras cannot be made to fit the tracks better ({errors}).{nothing}"
    fuller = f" {counted(done.cameras, 'camera')} got OPENCV's parameters." if done.cameras else ""
    return f"The cameras fit better: {errors}.{fuller}"


def _by_matches(fit: MatchedFit | None) -> list[str]:
    if fit is None:
        return []
    if not fit.enough:
        return [f"Only {counted(fit.matches, 'place')} matched in the photos: they were not used."]
    matched = f"{counted(fit.matches, 'place')} matched in {counted(fit.photos, 'photo')}"
    if not fit.better:
        return [f"With {matched}, they fit as well as they can ({fit.after:.3f} px)."]
    errors = f"{fit.before:.3f} -> {fit.after:.3f} px, median of {fit.left_out:,} left out"
    changed = " and ".join([", ".join(fit.changed[:-1]), fit.changed[-1]]).removeprefix(" and ")
    return [f"With {matched}: {errors} ({changed} changed)."]
