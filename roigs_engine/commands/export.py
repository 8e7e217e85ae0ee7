"""`export`: a COLMAP model's cameras and points as JSON and NumPy files; needs only numpy."""

from __future__ import annotations

import argparse
import os

from ..errors import ConfigError
from ..formats.text import counted
from .console import Console
from .options import add_scene_options, load_scene, read_files
from .out_folder import refuse_inputs
from .values import PATH

HELP = "write the cameras and points of a COLMAP model as JSON and NumPy files"
EXAMPLES = """\
  python -m roigs_engine export garden --out out
  python -m roigs_engine export garden --max-side 640 --out out --events
  python -m roigs_engine export garden --placed --out metres"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_scene_options(parser)
    parser.add_argument(
        "--placed",
        action="store_true",
        help="write them as the scene was placed in Blender (roigs_placement.json), in metres;"
        " default: in the COLMAP frame",
    )
    parser.add_argument("--out", type=PATH, required=True, metavar="DIR", help="folder to write to")


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Read the model and write the files."""
    from ..colmap.export import COLMAP, PLACED, SCENE, stored_transform, transformed, write_export
    from ..formats.scene_transform import transform_file

    refuse_inputs([args.out / SCENE], read_files(args))

    scene = load_scene(args, console)
    placement = None
    try:
        if args.placed or os.path.lexists(transform_file(args.scene)):
            placement = stored_transform(args.scene, scene)
    except ConfigError as error:
        if args.placed:
            raise
        console.context.warn(str(error))
    if placement is not None and args.placed:
        scene = transformed(scene, placement)
    frame = PLACED if args.placed else COLMAP
    outputs = write_export(scene, args.out, placement=placement, frame=frame)
    cameras, points = counted(len(scene.images), "camera"), counted(len(scene.points), "point")
    console.print(f"{cameras} and {points} in {args.out}")
    return outputs
