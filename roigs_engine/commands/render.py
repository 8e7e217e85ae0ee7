"""`render`: images of a PLY from a COLMAP model's cameras or along a camera path."""

from __future__ import annotations

import argparse

from ..errors import ConfigError
from .console import Console
from .options import add_device_option, add_size_options, context_on_device
from .values import NAME, PATH

HELP = "render a PLY from the cameras of a COLMAP model or along a camera path"
EXAMPLES = """\
  python -m roigs_engine render result.ply --scene garden --name IMG_0004.jpg --out frames
  python -m roigs_engine render result.ply --path cameras.json --out frames"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("ply", type=PATH, help="PLY to render")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--scene", type=PATH, metavar="DIR", help="COLMAP project with the cameras")
    source.add_argument(
        "--path", type=PATH, metavar="FILE", help="camera path, a JSON file (docs/files.md)"
    )
    parser.add_argument(
        "--name",
        type=NAME,
        action="append",
        default=[],
        help="render only the camera of this name; repeatable",
    )
    add_size_options(parser.add_argument_group("scene"))
    add_device_option(parser)
    parser.add_argument(
        "--out", type=PATH, required=True, metavar="DIR", help="folder for the pictures"
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Render every camera to a PNG."""
    import torch

    from ..kernels.library import set_threads
    from ..model.gaussians import Gaussians
    from ..rasterize.camera_path import load_camera_path
    from ..rasterize.sequence import render_sequence
    from .options import load_scene

    gaussians, frame = Gaussians.load_framed(args.ply)
    context = context_on_device(args, console)
    gaussians = gaussians.to(torch.device(context.device))
    if args.path:
        if args.threads is not None:
            set_threads(args.threads)
        cameras = load_camera_path(args.path)
    else:
        scene = load_scene(args, console)
        cameras = [(i.name, i.camera, i.world_to_camera) for i in scene.images]
    unknown = sorted(set(args.name) - {name for name, _, _ in cameras})
    if unknown:
        first = ", ".join(f"'{name}'" for name, _, _ in cameras[:3])
        raise ConfigError(
            f"There is no camera '{unknown[0]}' in {args.path or args.scene}.",
            f"The first ones are: {first}.",
        )
    if args.name:
        cameras = [camera for camera in cameras if camera[0] in args.name]
    local = [(name, camera, frame.transform(pose)) for name, camera, pose in cameras]
    render_sequence(gaussians, local, args.out, context)
    return {"pictures": str(args.out)}
