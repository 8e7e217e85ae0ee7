"""`train`: Scene-GS and the ROI stage, without baselines and evaluation."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .console import Console
from .options import (
    add_roi_options,
    add_scene_options,
    add_selection_options,
    add_training_options,
    boxes,
    load_scene,
    run_config,
)

if TYPE_CHECKING:
    from ..pipeline import Run

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
    parser.add_argument(
        "--run-dir", type=Path, required=True, metavar="DIR", help="folder of the run"
    )


def open_run(args: argparse.Namespace, console: Console) -> Run:
    """The run that the options describe, begun or gone on with; its events go to its folder too."""
    from ..pipeline import Run

    rois, config = boxes(args), run_config(args)
    scene = load_scene(args, console, args.run_dir / "cache")
    work = Run(
        args.run_dir, scene, rois, config, emit=console.emit, should_stop=console.should_stop
    )
    console.log_to(args.run_dir)
    return work


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Train, or go on with the run that is in the folder."""
    open_run(args, console).train()
    return {"result": str(args.run_dir / "result.ply"), "rois": str(args.run_dir / "rois")}
