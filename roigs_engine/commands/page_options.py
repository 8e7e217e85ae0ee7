"""The options of `convert` that are for a web page."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ConfigError
from ..model.roi import load_rois
from .values import NAME, PATH

if TYPE_CHECKING:
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


def refuse_page_options(args: argparse.Namespace) -> None:
    """Raise ConfigError if such an option is given for another format."""
    given = [name for name in ("title", "fly_to", "before") if getattr(args, name) is not None]
    if given and args.out.suffix.lower() != SUFFIX:
        option = f"--{given[0].replace('_', '-')}"
        raise ConfigError(
            f"{option} is for web pages alone.", f"Leave it out, or let OUT end in {SUFFIX}."
        )


def page_extras(args: argparse.Namespace, before: Arrays | None, turn: Float64) -> Extras:
    """The options' values, with the boxes turned as the model is."""
    from ..exchange.page import Extras
    from ..exchange.page_views import Ball

    boxes = load_rois(args.fly_to) if args.fly_to else []
    places = [
        (
            box.name,
            Ball(
                centre=turn[:3, :3] @ box.centre + turn[:3, 3],
                radius=float(np.linalg.norm(box.half_extents)),
            ),
        )
        for box in boxes
    ]
    return Extras(title=args.title or "", places=places, before=before)
