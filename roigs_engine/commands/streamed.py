"""A run's result in its levels of detail, as Streamed SOG."""

from __future__ import annotations

import argparse

from ..errors import ConfigError
from ..exchange.axes import turn
from ..formats.text import counted
from .console import Console
from .options import boxes
from .out_folder import refuse_inputs
from .run_scene import levelled_run
from .turning import shortened, turned, warn_of_axes

STREAMED = "lod-meta.json"


def write_streamed(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Write a run's result in its levels of detail."""
    from ..exchange import formats, streamed_sog
    from ..formats.levels import read_ladders

    folder = levelled_run(args.source)
    if boxes(args, required=False):
        raise ConfigError(f"{STREAMED} holds a whole result.", "Leave out the boxes.")
    if args.plain:
        raise ConfigError(f"{STREAMED} says how its Gaussians are drawn.", "Leave out --plain.")
    before = args.from_up or "-y"
    matrix = turn(before, args.up or "-y")
    if args.from_up is None:
        warn_of_axes(args.source, before, console)
    parts, files = [], []
    for ladder in read_ladders(folder).values():
        levels = []
        for level in ladder.levels:
            file = folder / level.ply
            refuse_inputs([args.out], [file], "Choose another OUT.")
            console.context.check_cancelled()
            levels.append(shortened(turned(formats.read(file), matrix), args))
            files.append(file)
        parts.append(levels)
    check, antialiased = console.context.check_cancelled, formats.are_antialiased(files)
    written = streamed_sog.write(args.out, parts, check, antialiased=antialiased)
    console.print(f"{counted(written, 'Gaussian')} in levels of detail in {args.out.parent}")
    return {"result": str(args.out)}
