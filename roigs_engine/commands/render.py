"""`render`: images of a PLY from a COLMAP model's cameras or along a camera path."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..errors import ConfigError
from ..formats.text import counted
from .console import Console
from .drawn_model import drawn_model
from .options import add_device_option, add_size_options, context_on_device, load_scene
from .run_scene import levelled_run
from .values import NAME, PATH, Number

if TYPE_CHECKING:
    import torch

    from ..levels.drawn import LevelledResult
    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame
    from ..model.scene import Camera, Float64
    from ..rasterize.camera_path import CameraPath

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
        "--path",
        type=PATH,
        metavar="FILE",
        help="camera path, a JSON file (docs/files.md); --downscale and --max-side apply to it",
    )
    parser.add_argument(
        "--name",
        type=NAME,
        action="append",
        default=[],
        help="render only the camera of this name; repeatable",
    )
    parser.add_argument(
        "--levels",
        action="store_true",
        help="draw the result of a run in its levels of detail, as its levels.json says",
    )
    parser.add_argument(
        "--quality",
        type=Number(low=0.01, high=100),
        default=1.0,
        metavar="Q",
        help="with --levels: how many times finer they shall be (default: %(default)s)",
    )
    add_size_options(parser.add_argument_group("scene"))
    add_device_option(parser)
    parser.add_argument(
        "--out", type=PATH, required=True, metavar="DIR", help="folder for the pictures"
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Render every camera to a PNG."""
    import torch

    from ..rasterize.image_files import render_sequence

    if args.path and args.images:
        raise ConfigError("--images has no meaning with --path.", "Leave it out.")
    whole, frame = drawn_model(args.ply, console.context.warn)
    context = context_on_device(args, console)
    device = torch.device(context.device)
    whole = whole.to(device)
    levels = _levels(args, frame, device) if args.levels else None
    cameras = _cameras(args, console)
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

    def drawn(camera: Camera, world_to_camera: Float64) -> Gaussians:
        return whole if levels is None else levels.gaussians(camera, world_to_camera)

    written = render_sequence(drawn, local, args.out, context)
    console.print(f"{counted(len(written), 'picture')} in {args.out}")
    return {"pictures": str(args.out)}


def _levels(args: argparse.Namespace, frame: LocalFrame, device: torch.device) -> LevelledResult:
    """The levels beside the PLY."""
    from ..levels.drawn import LevelledResult

    folder = levelled_run(args.ply)
    return LevelledResult(folder, frame, quality=args.quality, device=device)


def _cameras(args: argparse.Namespace, console: Console) -> CameraPath:
    """The cameras of the scene or of the path, at the size of the options."""
    from ..colmap.project import smaller
    from ..kernels.library import set_threads
    from ..rasterize.camera_path import load_camera_path

    if args.scene:
        scene = load_scene(args, console)
        return [(i.name, i.camera, i.world_to_camera) for i in scene.images]
    if args.threads is not None:
        set_threads(args.threads)
    shrink = smaller(args.downscale, args.max_side)
    return [
        (name, camera.resized(*shrink(camera.width, camera.height)), pose)
        for name, camera, pose in load_camera_path(args.path)
    ]
