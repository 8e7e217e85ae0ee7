"""`cut`: objects cut out of their boxes, along masks on some photos."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.files import own_folder
from ..formats.projects import top_folder
from ..formats.run_files import BACKGROUND, FINE
from ..formats.splat_ply import check_ply
from ..formats.text import counted
from ..photos.mask_files import MASKS, MaskOptions
from .console import Console
from .options import (
    add_device_option,
    add_roi_options,
    add_size_options,
    boxes,
    context_on_device,
    load_scene,
    read_files,
)
from .out_folder import refuse_inputs
from .values import PATH

if TYPE_CHECKING:
    from torch import Tensor

    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame
    from ..model.roi import OrientedBox
    from ..training.labels import MaskedView

HELP = "cut objects out of their boxes along masks: the vase without the table under it"
EXAMPLES = """\
  python -m roigs_engine cut garden --rois garden/rois.json --model runs/garden/result.ply \\
      --out cut"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "scene", type=PATH, help="folder with a COLMAP model (sparse/0, sparse, or the model)"
    )
    group = parser.add_argument_group("scene")
    add_size_options(group)
    group.add_argument(
        "--masks",
        type=PATH,
        metavar="DIR",
        help="folder with a folder of masks for each box: DIR/vase/012.jpg.png shows the object of"
        " box vase on the photo 012.jpg, all else is black (default: masks in the scene's folder)",
    )
    group.add_argument(
        "--invert-masks", action="store_true", default=None, help="black marks the object"
    )
    add_roi_options(parser)
    add_device_option(parser)
    parser.add_argument(
        "--model", type=PATH, required=True, metavar="FILE", help="PLY in the COLMAP frame"
    )
    parser.add_argument(
        "--out",
        type=PATH,
        required=True,
        metavar="DIR",
        help=f"folder to write to: {FINE}/ROI.ply, and {BACKGROUND} with all else",
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Label the Gaussians of each box that has masks, and write the objects and the rest."""
    import torch

    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame
    from ..model.ownership import owners

    rois = boxes(args)
    files = {roi.name: own_folder(args.out, FINE) / f"{roi.name}.ply" for roi in rois}
    refuse_inputs([*files.values(), args.out / BACKGROUND], [*read_files(args), args.model])
    check_ply(args.model)
    folders = _folders(args, rois)
    frame = LocalFrame.of_scene(load_scene(args, console))
    context = context_on_device(args, console)
    model = Gaussians.load_ply(args.model, frame).to(torch.device(context.device))
    owner = owners(model, [frame.box(roi) for roi in rois])
    rest = torch.ones(len(model), dtype=torch.bool, device=owner.device)
    for index, roi in enumerate(rois):
        rows = owner == index
        if roi.name in folders:
            views = _views(args, folders[roi.name], frame, console.context)
            rows = _object(model, views, rows, roi.name, context)
        else:
            context.info(f"Box '{roi.name}' has no masks: it stays whole.")
        rest &= ~rows
        model.rows(rows).save_ply(files[roi.name], frame)
    model.rows(rest).save_ply(args.out / BACKGROUND, frame)
    outputs = {"objects": str(args.out / FINE), "rest": str(args.out / BACKGROUND)}
    console.print_places(outputs)
    return outputs


def _folders(args: argparse.Namespace, rois: list[OrientedBox]) -> dict[str, Path]:
    """Box -> folder of its masks, of the boxes that have one; ConfigError if none has."""
    root = args.masks or top_folder(args.scene) / MASKS
    found = {roi.name: root / roi.name for roi in rois if (root / roi.name).is_dir()}
    if not found:
        names = ", ".join(roi.name for roi in rois)
        raise ConfigError(
            f"{root} has no folder of masks for a box ({names}).",
            f"Put masks into {root / rois[0].name}, or give --masks the folder above it.",
        )
    return found


def _views(
    args: argparse.Namespace, folder: Path, frame: LocalFrame, context: Context
) -> list[MaskedView]:
    """The photos with a mask of the object, as the model sees them."""
    import torch

    from ..colmap.project import load_colmap
    from ..colmap.undistort import temporary_folder
    from ..photos.masks import load_mask

    options = MaskOptions(folder=folder, inverted=bool(args.invert_masks), others=False)
    scene = load_colmap(
        args.scene,
        images=args.images,
        cache=temporary_folder(),
        downscale=args.downscale,
        max_side=args.max_side,
        masks=options,
        pixels=False,
        context=replace(context, emit=QUIET.emit),
    )
    views = []
    for image in frame.scene(scene).images:
        mask = load_mask(image)
        if mask is not None:
            views.append((image.camera, image.world_to_camera, torch.from_numpy(mask)))
    if not views:
        raise ConfigError(
            f"{folder} has no mask that shows an object.",
            "The mask of the photo 012.jpg is 012.jpg.png: white where the object is, else black.",
        )
    return views


def _object(
    model: Gaussians, views: list[MaskedView], owned: Tensor, name: str, context: Context
) -> Tensor:
    """(N,) bool: the Gaussians of a box's object, of those that the box owns; says how many."""
    from ..training.labels import mask_votes, object_rows

    rows = object_rows(model, mask_votes(model, views, context), owned)
    context.info(
        f"Box '{name}': {int(rows.sum()):,} of {int(owned.sum()):,} Gaussians are the object's, by"
        f" masks on {counted(len(views), 'photo')}."
    )
    if not bool(rows.any()):
        context.warn(
            f"No Gaussian of box '{name}' is the object's. If black marks it, use --invert-masks."
        )
    return rows
