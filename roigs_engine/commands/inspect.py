"""`inspect`: the contents of a COLMAP model, and the photos that see each box."""

from __future__ import annotations

import argparse
import json

from ..colmap.inspect import format_inspection, inspect_scene
from ..colmap.photo_loader import without_damaged
from .console import Console
from .options import add_roi_options, add_scene_options, boxes, load_scene

HELP = "show what a COLMAP model contains and which photos see each box"
EXAMPLES = """\
  python -m roigs_engine inspect garden
  python -m roigs_engine inspect garden --rois garden/rois.json --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_scene_options(parser)
    add_roi_options(parser)
    parser.add_argument(
        "--check-photos", action="store_true", help="decode every photo, and skip damaged ones"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Load the scene, inspect it and print the result."""
    rois = boxes(args, required=False)
    scene = load_scene(args, console)
    if args.check_photos:
        scene = without_damaged(scene, console.context)
    report = inspect_scene(scene, rois)
    console.print(json.dumps(report, indent=1) if args.json else format_inspection(report))
    return {}
