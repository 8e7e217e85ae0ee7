"""`clean`: remove from a run folder what can be made again."""

from __future__ import annotations

import argparse

from ..errors import RunFolderError
from ..formats import clean_up
from ..formats.lock import locked
from ..formats.text import in_gb
from .console import Console
from .values import PATH

HELP = "remove from a run folder what can be made again: caches, archived stages, previews"
EXAMPLES = """\
  python -m roigs_engine clean runs/garden --dry-run
  python -m roigs_engine clean runs/garden"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("run", type=PATH, help="folder of the run; its results stay")
    parser.add_argument(
        "--dry-run", action="store_true", help="print what would be removed, and remove nothing"
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Print what can be removed, and remove it."""
    if not clean_up.is_run_folder(args.run):
        raise RunFolderError(
            f"{args.run} is not a run folder.", "Give the folder that --run-dir named."
        )
    with locked(args.run, console.context.warn, option=None):
        for path in clean_up.removable(args.run):
            console.print(f"{in_gb(clean_up.disk_size([path])):>8}  {path.relative_to(args.run)}")
        if args.dry_run:
            return {}
        freed = clean_up.remove(args.run)
    console.context.info(f"Removed {in_gb(freed)}." if freed else "There is nothing to remove.")
    return {}
