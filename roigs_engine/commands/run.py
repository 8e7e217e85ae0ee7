"""`run`: select photos, train, compare and evaluate in one command."""

from __future__ import annotations

import argparse

from ..errors import ConfigError
from ..formats import run_files
from ..formats.lock import check_held
from ..run.config import COMPARISONS
from . import train
from .console import Console
from .options import run_config

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


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Train and evaluate; an unfinished run resumes."""
    if run_config(args).test_every == 0:
        raise ConfigError(
            "--test-every 0 leaves no test photo to evaluate.", "Use `train` with it."
        )
    compare = COMPARISONS if "all" in args.compare else args.compare
    if args.dry_run:
        return train.show_plan(args, console, compare)
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
    places = {
        "report": run_files.REPORT,
        "page": run_files.REPORT_PAGE,
        "pictures": run_files.CROPS,
        "result": run_files.RESULT,
        "rois": run_files.FINE,
    }
    outputs = {what: str(args.run_dir / where) for what, where in places.items()}
    console.print_places(outputs)
    return outputs
