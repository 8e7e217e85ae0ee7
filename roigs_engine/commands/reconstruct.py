"""`reconstruct`: a COLMAP project from photos; does not need torch."""

from __future__ import annotations

import argparse

from ..errors import ConfigError
from ..reconstruction.settings import (
    CAMERA_MODELS,
    CAMERAS,
    FEW_PHOTOS,
    MANY,
    PAIRS,
    USUAL,
    Settings,
)
from .console import Console
from .options import add_mask_options, add_threads_option, mask_options
from .values import PATH, integer

HELP = "make a COLMAP project from a folder of photos, or a video"
EXAMPLES = """\
  python -m roigs_engine reconstruct photos --out garden
  python -m roigs_engine reconstruct garden/images --out garden --pairs all
  python -m roigs_engine reconstruct walk.mp4 --out garden"""
MOST_FEATURES, LARGEST_SIDE, MOST_NEIGHBOURS = 32_768, 8_192, 1_000
MOST_FRAMES = 10_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("photos", type=PATH, help="folder of the photos, or a video")
    parser.add_argument(
        "--out",
        type=PATH,
        required=True,
        metavar="SCENE",
        help="folder of the project: gets images, sparse/0, database.db and reconstruction.md;"
        " the same command resumes",
    )
    add_mask_options(parser)
    parser.add_argument(
        "--frames",
        type=integer(2, MOST_FRAMES),
        metavar="N",
        help="use about N frames of a video (default: as many as its motion asks for)",
    )
    add_method_options(parser.add_argument_group("method"))
    add_threads_option(parser)


def add_method_options(group: argparse._ArgumentGroup) -> None:
    """What decides the result."""
    default = Settings()
    group.add_argument(
        "--max-side",
        type=integer(64, LARGEST_SIDE),
        default=default.max_side,
        metavar="PX",
        help=f"longest side of photos in which features are found (default: {default.max_side})",
    )
    group.add_argument(
        "--features",
        type=integer(64, MOST_FEATURES, zero=True),
        default=default.features,
        metavar="N",
        help=f"most features of a photo (default: 0, which is {USUAL}, and {MANY} of up to"
        f" {FEW_PHOTOS} photos)",
    )
    group.add_argument(
        "--pairs",
        choices=PAIRS,
        default=default.pairs,
        help="photos to match: all pairs, the similar ones, those that follow one another by name"
        " (and similar ones), or all of few photos and else the similar ones (auto, the default)",
    )
    group.add_argument(
        "--neighbours",
        type=integer(1, MOST_NEIGHBOURS),
        default=default.neighbours,
        metavar="N",
        help=f"similar photos that each is matched with (default: {default.neighbours})",
    )
    group.add_argument(
        "--cameras",
        choices=CAMERAS,
        default=default.cameras,
        help="photos that share a camera: those of one device, lens, focal length and size (auto,"
        " the default), all of one size, or none",
    )
    group.add_argument(
        "--camera-model",
        choices=CAMERA_MODELS,
        default=default.camera_model,
        help=f"COLMAP's lens model (default: {default.camera_model})",
    )
    group.add_argument(
        "--seed", type=integer(0), default=0, metavar="N", help="seed of random numbers"
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Reconstruct the photos."""
    from ..formats.projects import is_video
    from ..reconstruction.reconstruct import reconstruct  # needs Pillow, which others do not

    settings = Settings(
        max_side=args.max_side,
        features=args.features,
        pairs=args.pairs,
        neighbours=args.neighbours,
        cameras=args.cameras,
        camera_model=args.camera_model,
        seed=args.seed,
    )
    masks = mask_options(args)
    masks.check()
    if args.frames and not is_video(args.photos):
        raise ConfigError(f"{args.photos} is no video.", "Leave out --frames.")
    console.log_later()
    model = reconstruct(
        args.photos,
        args.out,
        settings,
        args.threads,
        console.context,
        console.log_to,
        frames=args.frames or 0,
        masks=masks,
    )
    outputs = {"scene": str(args.out), "report": str(args.out / "reconstruction.md")}
    console.print_places(outputs | {"model": str(model)})
    return outputs
