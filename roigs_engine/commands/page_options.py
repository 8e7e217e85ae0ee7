"""The options of `convert` that are for a web page."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ConfigError
from ..exchange.axes import turn
from ..formats.gravity import gravity_alignment
from ..model.roi import load_rois
from .run_scene import poses_of, scene_of_run
from .values import NAME, PATH

if TYPE_CHECKING:
    from ..context import Context
    from ..exchange.arrays import Arrays
    from ..exchange.page import Extras
    from ..model.scene import Float64

SUFFIX = ".html"


def add_page_options(parser: argparse.ArgumentParser) -> None:
    """What a page shows besides the model."""
    group = parser.add_argument_group("web page (OUT.html)")
    group.add_argument(
        "--title", type=NAME, metavar="TEXT", help="of the page (default: the name of OUT)"
    )
    group.add_argument(
        "--fly-to",
        type=PATH,
        metavar="FILE",
        help="rois.json: a button for each box, which flies there; crops nothing",
    )
    group.add_argument(
        "--before", type=PATH, metavar="FILE", help="a second model, to switch between before/after"
    )
    group.add_argument(
        "--scene",
        dest="page_scene",
        type=PATH,
        metavar="DIR",
        help="COLMAP project that IN was trained on: its photos tell which way is up, and from"
        " where to look first (default: that of IN's run folder, if it has one); also for --plain",
    )


def refuse_page_options(args: argparse.Namespace, *, plain: bool) -> None:
    """Raise ConfigError if such an option is given for another format.

    Args:
        args: of the command.
        plain: whether OUT is for viewers without anti-aliasing, which needs the scene too.
    """
    names = ("title", "fly_to", "before", *(() if plain else ("page_scene",)))
    given = [name for name in names if getattr(args, name) is not None]
    if args.out.suffix.lower() != SUFFIX:
        if given:
            option = f"--{given[0].removeprefix('page_').replace('_', '-')}"
            also = " and --plain" if given[0] == "page_scene" else ""
            raise ConfigError(
                f"{option} is for web pages{also} alone.",
                f"Leave it out, or let OUT end in {SUFFIX}.",
            )
        return
    if args.page_scene is not None and args.from_up is not None:
        raise ConfigError("--scene and --from-up both say which way is up.", "Leave out one.")


def page_poses(args: argparse.Namespace, context: Context) -> Float64 | None:
    """(N, 4, 4) world_to_camera of the scene's photos; None if no scene is known.

    Raises:
        SceneError: the one of `--scene` cannot be read.
    """
    from ..colmap.project import load_colmap

    scene = None
    if args.page_scene is not None:
        scene = load_colmap(args.page_scene, pixels=False, context=context)
    elif args.from_up is None:
        scene = scene_of_run(args.source.absolute().parent)
    return None if scene is None else poses_of(scene)


def page_turn(poses: Float64, up: str) -> Float64:
    """(4, 4) from the photos' frame to one in which the axis `up` does point up."""
    matrix = turn("z", up)
    matrix[:3, :3] = matrix[:3, :3] @ gravity_alignment(poses)
    return matrix


def page_extras(
    args: argparse.Namespace, before: Arrays | None, matrix: Float64, poses: Float64 | None
) -> Extras:
    """The options' values, with the boxes and the photos' poses turned as the model is."""
    from ..exchange.formats import is_antialiased
    from ..exchange.page import Extras
    from ..exchange.page_views import Ball

    boxes = load_rois(args.fly_to) if args.fly_to else []
    places = [
        (
            box.name,
            Ball(
                centre=matrix[:3, :3] @ box.centre + matrix[:3, 3],
                radius=float(np.linalg.norm(box.half_extents)),
            ),
        )
        for box in boxes
    ]
    if poses is not None:
        poses = poses @ np.linalg.inv(matrix)
    return Extras(
        title=args.title or "",
        places=places,
        before=before,
        before_antialiased=before is not None and is_antialiased(args.before),
        poses=poses,
    )
