"""`levels`: the result of a run in levels of detail."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..errors import RunFolderError
from ..formats import clean_up, run_files
from ..formats.lock import locked
from .console import Console
from .options import add_device_option, add_threads_option, context_on_device
from .run_scene import cameras_of_run
from .train import MOST_LEVELS
from .values import PATH, integer

if TYPE_CHECKING:
    from ..formats.levels import Ladder

HELP = "make levels of detail of a run's result: fewer Gaussians for views from afar"
EXAMPLES = """\
  python -m roigs_engine levels runs/garden"""
MOST_STEPS = 100_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("run", type=PATH, help="folder of the run")
    parser.add_argument(
        "--levels",
        type=integer(2, MOST_LEVELS),
        default=5,
        metavar="N",
        help="how many, with the whole one; each has half the Gaussians of the one before"
        " (default: %(default)s)",
    )
    parser.add_argument(
        "--steps",
        type=integer(1, MOST_STEPS),
        default=500,
        metavar="N",
        help="steps to train each level of each box for (default: %(default)s)",
    )
    parser.add_argument(
        "--scene", type=PATH, metavar="DIR", help="COLMAP project of the run, if it was moved"
    )
    add_threads_option(parser)
    add_device_option(parser)


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Train and measure the levels, or go on with them; write `levels.json`."""
    from ..kernels.library import set_threads
    from ..levels.make import make_levels
    from ..model.local_frame import LocalFrame

    if not clean_up.is_run_folder(args.run):
        raise RunFolderError(
            f"{args.run} is not a run folder.", "Give the folder that --run-dir named."
        )
    if args.threads is not None:
        set_threads(args.threads)
    context = context_on_device(args, console)
    with locked(args.run, console.context.warn, option=None):
        scene = cameras_of_run(args.run, args.scene, console.context)
        frame = LocalFrame.of_scene(scene)
        ladders = make_levels(
            args.run,
            frame.scene(scene).images,
            frame,
            levels=args.levels,
            steps=args.steps,
            context=context,
        )
    console.print(table(ladders))
    outputs = {"levels": str(args.run / run_files.LEVELS_FILE)}
    console.print_places(outputs)
    return outputs


def table(ladders: Sequence[Ladder]) -> str:
    """The levels as a table."""
    rows = [
        "| part | Gaussians | from | PSNR | whole, drawn so small |",
        "|---|---:|---:|---:|---:|",
    ]
    for ladder in ladders:
        for level in ladder.levels:
            name = ladder.box or "surroundings"
            if not level.farther:
                rows.append(f"| {name} | {level.gaussians:,} | | | |")
                continue
            psnr, whole = (level.measured[key] for key in ("psnr", "psnr_whole"))
            rows.append(
                f"| {name} | {level.gaussians:,} | {level.farther:.1f} x the distance"
                f" | {psnr:.1f} | {whole:.1f} |"
            )
    return "\n".join(rows)
