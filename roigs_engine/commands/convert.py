"""`convert`: models of Gaussians, placed and turned, as one file for other programs."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ConfigError
from ..formats.files import read_json
from ..formats.text import counted
from .console import Console
from .out_folder import refuse_inputs
from .placed_models import HINT, placed_models
from .values import PATH, integer

if TYPE_CHECKING:
    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame

HELP = "write Gaussians for other programs: moved models as one, without high SH degrees"
EXAMPLES = """\
  python -m roigs_engine convert runs/garden/result.ply small.ply --sh-degree 1
  python -m roigs_engine convert placed.json garden.ply"""
LIST, PLY = ".json", ".ply"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "source",
        type=PATH,
        metavar="IN",
        help="PLY, or a JSON list of PLYs and their places (docs/files.md)",
    )
    parser.add_argument("out", type=PATH, metavar="OUT", help="PLY to write")
    parser.add_argument(
        "--sh-degree",
        type=integer(0, 3, zero=True),
        metavar="N",
        help="highest degree of view-dependent colour, 0 to 3 (default: as it is)",
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Read the models, make them one, and write it."""
    from ..model.gaussians import Gaussians

    if args.out.suffix.lower() != PLY:
        raise ConfigError(f"{args.out} is not the name of a PLY.", "Write FILE.ply.")
    refuse_inputs([args.out], [args.source])
    if args.source.suffix.lower() == LIST:
        model, frame = _merged(args.source, args.out)
    else:  # as it is, bit for bit
        model, frame = Gaussians.load_framed(args.source, scaled=False)
    if args.sh_degree is not None:
        model = replace(model, sh=model.sh[:, : (args.sh_degree + 1) ** 2])
    model.save_ply(args.out, frame)
    console.print(f"{counted(len(model), 'Gaussian')} in {args.out}")
    return {"result": str(args.out)}


def _merged(source: Path, out: Path) -> tuple[Gaussians, LocalFrame]:
    """The models of a list, in their places, as one."""
    from ..exchange.merged import merged
    from ..model.gaussians import Gaussians
    from ..rasterize.placed import PlacedModel

    try:
        wanted = placed_models(read_json(source, ConfigError, HINT))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{source} is malformed ({error}).", HINT) from error
    refuse_inputs([out], [Path(ply) for ply, _ in wanted])
    read = {ply: Gaussians.load_framed(Path(ply)) for ply in dict.fromkeys(p for p, _ in wanted)}
    models = [
        PlacedModel(gaussians=read[ply][0], frame=read[ply][1], matrix=matrix)
        for ply, matrix in wanted
    ]
    if not any(len(model.gaussians) for model in models):
        raise ConfigError(f"{source} has no Gaussians.", "Give models that have some.")
    return merged(models)
