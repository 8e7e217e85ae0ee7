"""`convert`: files of Gaussians from one format to another, turned, cropped, placed."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ConfigError, RoiError
from ..exchange.axes import UP, turn
from ..formats.drawable import usable
from ..formats.files import read_json
from ..formats.text import counted
from .console import Console
from .options import add_roi_options, boxes
from .out_folder import refuse_inputs
from .page_options import SUFFIX as PAGE
from .page_options import (
    add_page_options,
    page_extras,
    page_poses,
    page_turn,
    refuse_page_options,
)
from .placed_models import HINT, photo_poses, placed_models
from .plain_models import photos_unknown, read_model
from .streamed import STREAMED, write_streamed
from .turning import shortened, turned, warn_of_axes
from .values import PATH, integer

if TYPE_CHECKING:
    from ..exchange.arrays import Arrays
    from ..model.scene import Float64
    from ..rasterize.instances import Instance

HELP = "write Gaussians in another format, turned, cropped to boxes, or placed as a list says"
EXAMPLES = """\
  python -m roigs_engine convert runs/garden/result.ply garden.spz
  python -m roigs_engine convert result.ply vase.glb --rois rois.json --only vase --sh-degree 0
  python -m roigs_engine convert placed.json garden.compressed.ply
  python -m roigs_engine convert result.ply vase.html --fly-to rois.json --before scene/model.ply"""
LIST = ".json"
SCENE_UP = "-y"
"""The axis that points up in formats that keep the frame of a scene."""
OTHER = "Choose another OUT."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "source",
        type=PATH,
        metavar="IN",
        help="file of Gaussians (.ply, .compressed.ply, .spz, .sog, .glb, .usdc, .splat), or a JSON"
        " list of files and their places (docs/files.md)",
    )
    parser.add_argument(
        "out",
        type=PATH,
        metavar="OUT",
        help="file to write; the end of its name says how: as above, or .usda, .usdz;"
        " .html: a web page to send, with the viewer inside; DIR/lod-meta.json: a run's levels of"
        " detail, for PlayCanvas",
    )
    parser.add_argument(
        "--up",
        choices=tuple(UP),
        help="axis that points up in OUT (default: as readers of the format have it)",
    )
    parser.add_argument(
        "--from-up",
        choices=tuple(UP),
        help="axis that points up in IN (default: as the format has it; -y for .ply)",
    )
    parser.add_argument(
        "--sh-degree",
        type=integer(0, 3),
        metavar="N",
        help="highest degree of view-dependent colour, 0 to 3 (default: as it is)",
    )
    parser.add_argument(
        "--plain",
        action="store_true",
        help="for viewers without anti-aliasing: each Gaussian becomes as faint as it looks in the"
        " photos, on average; always done for .glb, .usd and .splat. Needs a run's result in its"
        " folder, or --scene",
    )
    add_roi_options(parser)
    add_page_options(parser)


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Read the models, make them one, and write it."""
    from ..exchange import formats

    if args.out.name == STREAMED:
        refuse_page_options(args, plain=False)
        return write_streamed(args, console)
    target = formats.format_of(args.out)
    plain = bool(args.plain) or not target.keeps_antialiased
    refuse_page_options(args, plain=plain)
    listed = args.source.suffix.lower() == LIST
    home = np.eye(4) if listed else _home(args, args.source)
    before = args.from_up or ("-y" if listed else formats.format_of(args.source).up)
    matrix = turn(before, args.up or target.up)
    poses = None if listed or target.suffix != PAGE else page_poses(args, console.context)
    if poses is not None:
        matrix = page_turn(poses, args.up or target.up) @ home
    elif not listed and args.from_up is None:
        warn_of_axes(args.source, before, console)
    from_home = matrix @ home.T
    if listed:
        arrays, there, antialiased, poses = _placed(args, matrix, plain=plain)
    else:
        refuse_inputs([args.out], [args.source], OTHER)
        whole, antialiased = read_model(args.source, plain=plain, scene=args.page_scene)
        arrays = _cropped(whole, args, home)
        there = len(arrays["means"])
        console.context.check_cancelled()
        arrays = turned(arrays, matrix)
    arrays = shortened(arrays, args)
    console.context.check_cancelled()
    if antialiased and plain:
        photos_unknown(target, console)
    if target.suffix == PAGE:
        known = None if listed or poses is None else from_home
        extras = page_extras(args, _before(args, target.up, known), from_home, poses)
        written = formats.write(args.out, arrays, antialiased=antialiased, extras=extras)
    else:
        check = console.context.check_cancelled
        written = formats.write(args.out, arrays, check, antialiased=antialiased)
    size = args.out.stat().st_size / 1e6
    left = f" ({there - written:,} left out)" if written < there else ""
    console.print(f"{counted(written, 'Gaussian')}{left}, {size:.1f} MB in {args.out}")
    return {"result": str(args.out)}


def _home(args: argparse.Namespace, path: Path) -> Float64:
    """(4, 4) from a file's frame to that of the scene, in which boxes and photos are.

    Formats with -y up keep the scene's frame, whichever axis points up in it. A file of another
    format was turned; OUT, if it is one that keeps the scene's frame, tells how to turn it back.
    """
    from ..exchange import formats

    form, target = formats.format_of(path), formats.format_of(args.out)
    if form.up == SCENE_UP:
        return np.eye(4)
    up = args.up if args.up and target.up == SCENE_UP else SCENE_UP
    return turn(args.from_up or form.up, up)


def _before(args: argparse.Namespace, up: str, known: Float64 | None) -> Arrays | None:
    """The model of `--before`, as the first one is shown; `known` turns the scene upright."""
    if args.before is None:
        return None
    from ..exchange import formats

    refuse_inputs([args.out], [args.before], OTHER)
    home = _home(args, args.before)
    if known is None:
        matrix = turn(args.from_up or formats.format_of(args.before).up, args.up or up)
    else:
        matrix = known @ home
    return shortened(turned(_cropped(formats.read(args.before), args, home), matrix), args)


def _cropped(arrays: Arrays, args: argparse.Namespace, home: Float64) -> Arrays:
    """What is in the boxes; everything if none is given. `home` leads to the boxes' frame."""
    rois = boxes(args, required=False)
    if not rois:
        return arrays
    with np.errstate(invalid="ignore"):  # what is not finite is in no box
        means = arrays["means"].astype(np.float64) @ home[:3, :3].T
    inside = np.any([roi.contains(means) for roi in rois], axis=0)
    if not inside.any():
        raise RoiError("The boxes hold no Gaussian.", "Are they from the same scene?")
    return {name: values[inside] for name, values in arrays.items()}


def _placed(
    args: argparse.Namespace, matrix: Float64, *, plain: bool
) -> tuple[Arrays, int, bool, Float64 | None]:
    """The models of a list, in their places, as one; `plain` as in `read_model`.

    Returns:
        The model, how many Gaussians there are with those that cannot be drawn, whether it is
        drawn with anti-aliasing, and the poses of the list's photos, if it has any.
    """
    from ..exchange import formats
    from ..model.gaussians import Gaussians
    from ..rasterize.instances import Instance

    if boxes(args, required=False):
        raise ConfigError("A list of models cannot be cropped.", "Leave out the boxes.")
    try:
        record = read_json(args.source, ConfigError, HINT)
        wanted, poses = placed_models(record, args.source.parent), photo_poses(record)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{args.source} is malformed ({error}).", HINT) from error
    refuse_inputs([args.out], [args.source, *(Path(item.file) for item in wanted)], OTHER)
    names = dict.fromkeys(item.file for item in wanted)
    models = {name: read_model(Path(name), plain=plain, scene=args.page_scene) for name in names}
    read = {name: Gaussians.framed(usable(arrays)) for name, (arrays, _) in models.items()}
    if not any(len(gaussians) for gaussians, _ in read.values()):
        raise ConfigError(f"{args.source} has no Gaussians.", "Give models that have some.")
    if plain:
        antialiased = any(still for _, still in models.values())
    else:
        antialiased = formats.are_antialiased(Path(name) for name in names)
    placed = []
    for item in wanted:
        gaussians, frame = read[item.file]
        placed.append(
            Instance(
                gaussians=gaussians,
                frame=frame,
                matrix=matrix @ item.matrix,
                gains=item.gains,
                density=item.density,
            )
        )
    there = sum(len(models[item.file][0]["means"]) for item in wanted)
    return _merged(placed), there, antialiased, poses


def _merged(models: list[Instance]) -> Arrays:
    from ..exchange.merged import merged

    model, frame = merged(models)
    return model.arrays(frame)
