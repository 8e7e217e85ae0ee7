"""`cut`: objects cut out of their boxes, along masks on some photos."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..context import Context
from ..errors import ConfigError
from ..formats.files import own_folder
from ..formats.projects import top_folder
from ..formats.run_files import BACKGROUND, FINE
from ..formats.splat_ply import check_ply
from ..formats.text import counted
from ..model.mask_coverage import with_useful_masks
from ..model.ownership import count_owned
from ..photos.mask_paths import MASKS, MaskOptions
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

    from ..model.roi import OrientedBox
    from ..model.scene import PosedImage, SfmScene

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
    from ..training.labels import object_owners

    rois = boxes(args)
    files = {roi.name: own_folder(args.out, FINE) / f"{roi.name}.ply" for roi in rois}
    refuse_inputs([*files.values(), args.out / BACKGROUND], [*read_files(args), args.model])
    check_ply(args.model)
    scene = _masked_scene(args, rois, console)
    frame, context = LocalFrame.of_scene(scene), context_on_device(args, console)
    model = Gaussians.load_ply(args.model, frame).to(torch.device(context.device))
    local, images = [frame.box(roi) for roi in rois], frame.scene(scene).images
    owner = object_owners(model, local, images, context)
    _say(owner, count_owned(model, local), local, images, context)
    for index, roi in enumerate(rois):
        model.rows(owner == index).save_ply(files[roi.name], frame)
    model.rows(owner == -1).save_ply(args.out / BACKGROUND, frame)
    outputs = {"objects": str(args.out / FINE), "rest": str(args.out / BACKGROUND)}
    console.print_places(outputs)
    return outputs


def _masked_scene(
    args: argparse.Namespace, rois: Sequence[OrientedBox], console: Console
) -> SfmScene:
    """The scene with the masks of the boxes' objects; ConfigError if there are none."""
    root, names = args.masks or top_folder(args.scene) / MASKS, [roi.name for roi in rois]
    if not any((root / name).is_dir() for name in names):
        raise ConfigError(
            f"{root} has no folder of masks for a box ({', '.join(names)}).",
            f"Put masks into {root / names[0]}, or give --masks the folder above it.",
        )
    inverted = bool(args.invert_masks)
    masks = MaskOptions(folder=root, used=False, boxes=tuple(names), objects_inverted=inverted)
    scene = with_useful_masks(load_scene(args, console, masks=masks), rois, console.context)
    if not any(image.objects for image in scene.images):
        raise ConfigError(
            f"{root} has no mask that shows an object.",
            "The mask of the photo 012.jpg is 012.jpg.png: white where the object is, else black.",
        )
    return scene


def _say(
    owner: Tensor,
    owned: Sequence[int],
    rois: Sequence[OrientedBox],
    images: Sequence[PosedImage],
    context: Context,
) -> None:
    """Say of each box how many of its Gaussians are the object's."""
    for index, (roi, whole) in enumerate(zip(rois, owned, strict=True)):
        photos = sum(roi.name in image.objects for image in images)
        if not photos:
            context.info(f"Box '{roi.name}' has no masks: it stays whole.")
            continue
        found = int((owner == index).sum())
        context.info(
            f"Box '{roi.name}': {found:,} of {whole:,} Gaussians are the object's, by masks on"
            f" {counted(photos, 'photo')}."
        )
        if not found:
            context.warn(
                f"No Gaussian of box '{roi.name}' is the object's. If black marks it, use"
                " --invert-masks."
            )
