"""`run`: select photos, train, compare and evaluate in one command."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

from ..context import QUIET
from ..errors import ConfigError
from ..formats import run_files
from ..formats.lock import check_held
from ..run.config import COMPARISONS
from . import train
from .console import Console
from .options import run_config
from .values import NAME as TEXT

NAME = "run"
PREPARE, ALL = "prepare", "all"
"""Values of --part: open the folder and look at the photos; do all that is missing."""
HELP = "do everything: select photos, train, compare with baselines, evaluate"
EXAMPLES = """\
  python -m roigs_engine run garden --rois garden/rois.json --max-side 640 --run-dir runs/garden
  python -m roigs_engine run garden --rois garden/rois.json --run-dir runs/garden --dry-run
  python -m roigs_engine run garden --rois garden/rois.json --run-dir runs/all --compare all"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    train.add_arguments(parser)
    parser.add_argument(
        "--compare",
        nargs="*",
        choices=[*COMPARISONS, "all"],
        default=["full-scene"],
        help="models to train for comparison, with the same number of steps (default: full-scene)",
    )
    parser.add_argument(
        "--part",
        type=TEXT,
        action="append",
        default=[],
        metavar="PART",
        help="do one part only, as `batch` does, so that several engines can work in one run"
        " folder: 'prepare', then the name of each stage, then 'all' for the rest; repeatable",
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Train and evaluate; an unfinished run resumes."""
    check(args)
    compare = compared(args)
    if args.dry_run:
        return train.show_plan(args, console, compare)
    if args.part and ALL not in args.part:
        return _parts(args, console, compare)
    import torch

    from ..evaluation.crops import write_crops
    from ..evaluation.evaluate import evaluate
    from ..evaluation.report import format_markdown, write_report
    from ..evaluation.report_html import write_page
    from ..evaluation.report_pictures import comparisons
    from ..run.folder import train_opened

    with train.opened_run(args, console) as (opened, context):
        trained = train_opened(
            opened, compare, context, update=args.update, preview_seconds=args.preview_seconds
        )
        device = torch.device(context.device)
        models = [model.evaluated().to(device) for model in trained]
        scene, rois = opened.scene, opened.rois
        evaluation = evaluate(
            models,
            scene,
            opened.measured,
            rois,
            context=context,
            photos=opened.config.evaluate_on,
        )
        check_held(args.run_dir)
        write_report(evaluation, args.run_dir)
        write_crops(evaluation, models, scene, rois, args.run_dir, context=context)
        pictures = comparisons(evaluation, models, scene, rois, context=context)
        write_page(evaluation, pictures, args.run_dir)
        train.levels_of(opened, args, context)
    console.print(format_markdown(evaluation))
    return places(args, console)


def places(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Where everything is; printed."""
    found = {
        "report": run_files.REPORT,
        "page": run_files.REPORT_PAGE,
        "pictures": run_files.CROPS,
        "result": run_files.RESULT,
        "rois": run_files.FINE,
    }
    outputs = {what: str(args.run_dir / where) for what, where in found.items()}
    console.print_places(outputs)
    return outputs


def check(args: argparse.Namespace) -> None:
    """Raise ConfigError if these options train, but leave nothing to evaluate on."""
    if run_config(args).test_every == 0:
        raise ConfigError(
            "--test-every 0 leaves no test photo to evaluate.",
            "Use 2 or more, or `train`, which does not evaluate.",
        )


def compared(args: argparse.Namespace) -> Sequence[str]:
    """The models to compare with."""
    return COMPARISONS if "all" in args.compare else args.compare


def _parts(args: argparse.Namespace, console: Console, compare: Sequence[str]) -> dict[str, str]:
    """Prepare the folder, or train stages of it."""
    if PREPARE in args.part:
        with train.opened_run(args, console):
            pass
    stages = [name for name in args.part if name != PREPARE]
    if stages:
        from ..run.side_by_side import train_stage
        from ..run.strategies import plan_run

        run, context = train.prepared_run(args, console)
        plan = plan_run(run, compare, replace(context, emit=QUIET.emit))  # it was said before
        for name in stages:
            train_stage(run, plan, name, context)
    return {name: str(args.run_dir / name) for name in stages}
