"""`train`: Scene-GS and the ROI stage, without baselines and evaluation."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ConfigError
from ..formats.files import remove_leftovers
from ..formats.lock import locked
from ..selection.manual import load_given
from .console import Console
from .options import (
    add_device_option,
    add_roi_options,
    add_scene_options,
    add_selection_options,
    add_training_options,
    boxes,
    device,
    load_scene,
    run_config,
)

if TYPE_CHECKING:
    from ..run.pipeline import Run

HELP = "train the scene and its boxes to one PLY"
EXAMPLES = """\
  python -m roigs_engine train garden --rois garden/rois.json --run-dir runs/garden
  python -m roigs_engine train garden --rois garden/rois.json --run-dir runs/paper --preset paper"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command; `run` has the same and more."""
    add_scene_options(parser)
    add_roi_options(parser)
    add_selection_options(parser)
    add_training_options(parser)
    add_device_option(parser)
    parser.add_argument(
        "--run-dir", type=Path, required=True, metavar="DIR", help="folder of the run"
    )
    parser.add_argument(
        "--selection",
        type=Path,
        metavar="DIR",
        help="ROI.json files with the photos of each box, as `select --out` writes them; boxes"
        " without a file get theirs by --method",
    )
    parser.add_argument(
        "--update",
        action="store_true",
        help="a folder made for another request is brought up to date: what still fits is kept,"
        " the rest moved to its folder «older»",
    )
    parser.add_argument(
        "--preview-seconds",
        type=float,
        default=0.0,
        metavar="S",
        help="write the present Gaussians to preview.ply every S seconds of training",
    )
    parser.add_argument(
        "--image-cache",
        type=float,
        metavar="MB",
        help="keep so many megabytes of decoded photos in memory (default: a quarter of it)",
    )


@contextmanager
def open_run(args: argparse.Namespace, console: Console) -> Iterator[Run]:
    """The run that the options describe, begun or gone on with; its events go to its folder too.

    Its folder is locked as long as the block lasts.
    """
    from ..run.pipeline import Run
    from ..run.provenance import session

    rois, config = boxes(args), run_config(args)
    given = load_given(args.selection, rois) if args.selection else {}
    if not 0 <= args.preview_seconds < math.inf:
        raise ConfigError(f"--preview-seconds is {args.preview_seconds}.", "Use 0 or more.")
    if args.image_cache is not None and not 0 <= args.image_cache < math.inf:
        raise ConfigError(f"--image-cache is {args.image_cache}.", "Use 0 or more megabytes.")
    with locked(args.run_dir):
        remove_leftovers(args.run_dir)
        place = device(args, console)
        scene = load_scene(args, console, args.run_dir / "cache")
        work = Run(
            args.run_dir,
            scene,
            rois,
            config,
            given=given,
            update=args.update,
            preview_seconds=args.preview_seconds,
            image_cache=None if args.image_cache is None else int(1e6 * args.image_cache),
            device=place,
            emit=console.emit,
            should_stop=console.should_stop,
        )
        console.log_to(args.run_dir)
        for message in work.memory.messages():
            console.emit(message)
        with session(args.run_dir, config.seed, str(place)):
            yield work


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Train, or go on with the run that is in the folder."""
    with open_run(args, console) as work:
        work.train()
    return {"result": str(args.run_dir / "result.ply"), "rois": str(args.run_dir / "rois")}
