"""`floaters`: finds what hangs in the air in a model, as a training does at its end."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ConfigError
from ..formats.drawable import drawable, usable
from ..formats.files import atomic_write, read_json
from ..formats.text import counted
from ..run.presets import preset
from .console import Console
from .options import (
    add_device_option,
    add_roi_options,
    add_scene_options,
    boxes,
    context_on_device,
    load_scene,
    read_files,
)
from .out_folder import refuse_inputs
from .placed_models import HINT, Placed, placed_models
from .values import PATH, integer

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame
    from ..rasterize.instances import Instance

HELP = "find Gaussians that hang in the air, by the rule with which a training ends"
EXAMPLES = """\
  python -m roigs_engine floaters garden --rois garden/rois.json --model result.ply \\
      --out floaters.npy"""
LIST = ".json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_scene_options(parser)
    add_roi_options(parser)
    add_device_option(parser)
    parser.add_argument(
        "--model",
        type=PATH,
        required=True,
        metavar="FILE",
        help="PLY in the COLMAP frame, or a JSON list of PLYs and their places (docs/files.md)",
    )
    parser.add_argument(
        "--min-views",
        type=integer(1),
        default=preset("draft").roi.min_views,
        metavar="N",
        help="photos that must show what is before the boxes or the scene (default: %(default)s)",
    )
    parser.add_argument(
        "--out",
        type=PATH,
        required=True,
        metavar="FILE.npy",
        help="NumPy file to write: for each Gaussian, in the order of the files, whether it is one",
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Look at the model from the photos' places, and write what floats."""
    import torch

    from ..model.local_frame import LocalFrame
    from ..training.floaters import floaters

    wanted = _wanted(args.model)
    inputs = [*read_files(args), args.model, *(Path(item.file) for item in wanted)]
    refuse_inputs([args.out], inputs)
    rois, scene = boxes(args, required=False), load_scene(args, console)
    frame = LocalFrame.of_scene(scene)
    local = frame.scene(scene)
    model, there = _model(wanted, frame)
    context = context_on_device(args, console)
    found = np.zeros(len(there), bool)
    if len(model):
        found[there] = (
            floaters(
                model.to(torch.device(context.device)),
                local.images,
                [frame.box(roi) for roi in rois],
                local.points,
                args.min_views,
                context,
            )
            .cpu()
            .numpy()
        )
    with atomic_write(args.out) as file:
        np.save(file, found)
    console.print(f"{counted(int(found.sum()), 'floater')} among {len(found):,} Gaussians")
    return {"floaters": str(args.out)}


def _wanted(path: Path) -> list[Placed]:
    """The models of `--model`."""
    if path.suffix.lower() != LIST:
        return [Placed(str(path), np.eye(4), (1.0, 1.0, 1.0))]
    try:
        return placed_models(read_json(path, ConfigError, HINT), path.parent)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{path} is malformed ({error}).", HINT) from error


def _model(wanted: list[Placed], frame: LocalFrame) -> tuple[Gaussians, NDArray[np.bool_]]:
    """All models as one in a frame, and which rows of the files it has: those that can be drawn."""
    from ..exchange.merged import merged
    from ..formats.splat_ply import is_antialiased, read_ply
    from ..model.gaussians import Gaussians
    from ..rasterize.instances import Instance

    into = np.diag([*[frame.scale] * 3, 1.0])
    into[:3, 3] = -frame.scale * frame.origin
    masks, models = [], []
    for item in wanted:
        path = Path(item.file)
        arrays = read_ply(path)
        mask = drawable(arrays)
        masks.append(mask)
        if mask.any():
            kept, own = Gaussians.framed(usable(arrays, mask), antialiased=is_antialiased(path))
            models.append(Instance(gaussians=kept, frame=own, matrix=into @ item.matrix))
    if not models:
        raise ConfigError("The model has no Gaussians that can be drawn.", "Give another model.")
    model, own = merged(_alike(models))
    whole = Gaussians.from_arrays(model.arrays(own), antialiased=model.antialiased)
    return whole, np.concatenate(masks)


def _alike(models: list[Instance]) -> list[Instance]:
    """All with anti-aliasing or all without, as most Gaussians are drawn.

    They are judged as one model, which is either; it matters little for what hides what.
    """
    counts = {True: 0, False: 0}
    for model in models:
        counts[model.gaussians.antialiased] += len(model.gaussians)
    most = counts[True] > counts[False]
    return [replace(m, gaussians=replace(m.gaussians, antialiased=most)) for m in models]
