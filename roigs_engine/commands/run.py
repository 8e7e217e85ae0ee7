"""`run`: select, train, compare, evaluate: from photos to table in one command."""

from __future__ import annotations

import argparse

from ..config import COMPARISONS
from . import train
from .console import Console
from .options import boxes, load_scene, run_config

HELP = "do everything: select, train, compare with baselines, evaluate"
EXAMPLES = """\
  python -m roigs_engine run garden --rois garden/rois.json --max-side 640 --run-dir runs/garden
  python -m roigs_engine run garden --rois garden/rois.json --run-dir runs/all --compare all"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    train.add_arguments(parser)
    parser.add_argument(
        "--compare",
        nargs="*",
        choices=[*COMPARISONS, "all"],
        default=["full-scene"],
        help="what else is trained for the table, each with the same steps (default: full-scene)",
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Train and evaluate; a folder that holds part of it is gone on with."""
    from ..crops import write_crops
    from ..evaluate import evaluate
    from ..pipeline import Run
    from ..report import format_markdown, write_report

    rois, config = boxes(args), run_config(args)
    scene = load_scene(args, console, args.run_dir / "cache")
    work = Run(
        args.run_dir, scene, rois, config, emit=console.emit, should_stop=console.should_stop
    )
    console.log_to(args.run_dir)
    compare = COMPARISONS if "all" in args.compare else args.compare
    trained = work.train(compare)
    evaluation = evaluate(trained.models, scene, work.test, rois, emit=console.emit)
    write_report(evaluation, args.run_dir)
    write_crops(evaluation, trained.models, scene, rois, args.run_dir)
    console.print(format_markdown(evaluation))
    outputs = {"report": "report.md", "pictures": "crops", "result": "result.ply", "rois": "rois"}
    for what, where in outputs.items():
        console.print(f"{what + ':':10}{args.run_dir / where}")
    return {what: str(args.run_dir / where) for what, where in outputs.items()}
