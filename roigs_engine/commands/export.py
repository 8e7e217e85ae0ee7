"""`export`: a COLMAP model's cameras and points as JSON and NumPy files; needs only numpy."""

from __future__ import annotations

import argparse

from ..formats.text import counted
from .console import Console
from .options import add_scene_options, load_scene, read_files
from .out_folder import refuse_inputs
from .values import PATH

HELP = "write the cameras and points of a COLMAP model as JSON and NumPy files"
EXAMPLES = """\
  python -m roigs_engine export garden --out out
  python -m roigs_engine export garden --max-side 640 --out out --events"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_scene_options(parser)
    parser.add_argument("--out", type=PATH, required=True, metavar="DIR", help="folder to write to")


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Read the model and write the files."""
    from ..colmap.export import SCENE, write_export

    refuse_inputs([args.out / SCENE], read_files(args))

    scene = load_scene(args, console)
    outputs = write_export(scene, args.out)
    cameras, points = counted(len(scene.images), "camera"), counted(len(scene.points), "point")
    console.print(f"{cameras} and {points} in {args.out}")
    return outputs
