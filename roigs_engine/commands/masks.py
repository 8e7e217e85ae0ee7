"""`masks`: masks of objects on many photos, from a few strokes on one."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.files import own_folder
from ..formats.scribbles import Scribble, read_scribbles
from ..formats.splat_ply import check_ply
from ..photos.mask_paths import MaskOptions
from .console import Console
from .options import (
    add_device_option,
    add_roi_options,
    add_threads_option,
    boxes,
    context_on_device,
    read_files,
)
from .out_folder import refuse_inputs
from .values import NAME, PATH

if TYPE_CHECKING:
    from ..masking.propagate import Knowledge
    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame
    from ..model.roi import OrientedBox
    from ..model.scene import SfmScene

HELP = "make masks of an object on many photos from a few strokes on one"
EXAMPLES = """\
  python -m roigs_engine masks garden --rois garden/rois.json --scribbles strokes.json \\
      --model runs/garden/result.ply --out garden/masks"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "scene", type=PATH, help="folder with a COLMAP model (sparse/0, sparse, or the model)"
    )
    group = parser.add_argument_group("scene")
    group.add_argument(
        "--images",
        type=PATH,
        metavar="DIR",
        help="folder of the photos (default: images, images_2, images_4 or images_8)",
    )
    add_threads_option(group)
    add_roi_options(parser)
    add_device_option(parser)
    parser.add_argument(
        "--scribbles",
        type=PATH,
        required=True,
        metavar="FILE",
        help="JSON with strokes on the object and around it, in one photo or more (docs/files.md)",
    )
    parser.add_argument(
        "--model",
        type=PATH,
        metavar="FILE",
        help="PLY of the trained scene in the COLMAP frame; without it, masks are less exact",
    )
    parser.add_argument(
        "--photo",
        type=NAME,
        action="append",
        default=[],
        metavar="NAME",
        help="a photo to make a mask for; repeatable (default: those that select chooses)",
    )
    parser.add_argument(
        "--anew",
        action="store_true",
        help="make all masks anew: strokes that correct one photo then help the others",
    )
    parser.add_argument(
        "--out",
        type=PATH,
        required=True,
        metavar="DIR",
        help="folder of the masks, of the box vase in DIR/vase; masks that are there and were not"
        " made by this command are used, and stay",
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Make the masks of each box that has strokes."""
    from ..kernels.library import set_threads
    from ..masking.opencv import opencv
    from ..model.local_frame import LocalFrame

    rois = boxes(args)
    scribbles = _scribbles(args, rois)
    refuse_inputs([args.out], [*read_files(args), args.scribbles, args.model])
    if args.model is not None:
        check_ply(args.model)
    opencv()
    if args.threads is not None:
        set_threads(args.threads)
    context = context_on_device(args, console)
    scene = _scene(args, context)
    _check_photos(args, scribbles, scene)
    frame = LocalFrame.of_scene(scene)
    model = None if args.model is None else _model(args.model, frame, context)
    if model is None:
        context.info("Without --model, masks follow the sparse points and colours: check each.")
    outputs = {}
    for roi in rois:
        own = {each.photo: each for each in scribbles if each.box == roi.name}
        if own:
            knowledge = _knowledge(model, scene, roi, rois, frame, context)
            outputs[roi.name] = _make(args, scene, roi, rois, own, frame, knowledge, context)
    console.print_places(outputs)
    return outputs


def _scribbles(args: argparse.Namespace, rois: list[OrientedBox]) -> list[Scribble]:
    """The scribbles for these boxes; ConfigError if there is none."""
    found = read_scribbles(args.scribbles)
    names = [roi.name for roi in rois]
    wanted = [scribble for scribble in found if scribble.box in names]
    if not wanted:
        raise ConfigError(
            f"{args.scribbles} has no stroke for a box ({', '.join(names)}).",
            "Name the box as in rois.json.",
        )
    return wanted


def _scene(args: argparse.Namespace, context: Context) -> SfmScene:
    """The cameras and points; photos are decoded when they are worked on."""
    from ..colmap.project import load_colmap

    return load_colmap(
        args.scene,
        images=args.images,
        masks=MaskOptions(used=False),
        pixels=False,
        context=replace(context, emit=QUIET.emit),
    )


def _check_photos(args: argparse.Namespace, scribbles: list[Scribble], scene: SfmScene) -> None:
    """Raise ConfigError if the scene has not all photos that are named."""
    there = {image.name for image in scene.images}
    for name in (*args.photo, *(scribble.photo for scribble in scribbles)):
        if name not in there:
            raise ConfigError(
                f"The scene has no photo '{name}' that can be used.",
                "Use the name of a photo in the COLMAP model.",
            )


def _model(path: Path, frame: LocalFrame, context: Context) -> Gaussians:
    import torch

    from ..model.gaussians import Gaussians

    return Gaussians.load_ply(path, frame).to(torch.device(context.device))


def _knowledge(
    model: Gaussians | None,
    scene: SfmScene,
    roi: OrientedBox,
    rois: list[OrientedBox],
    frame: LocalFrame,
    context: Context,
) -> Knowledge:
    """What carries masks from photo to photo."""
    if model is None:
        from ..masking.point_votes import PointVotes

        return PointVotes(frame.scene(scene), frame.box(roi))
    from ..masking.gaussian_votes import GaussianVotes

    votes = GaussianVotes(model, frame.box(roi), [frame.box(each) for each in rois], context)
    if votes.is_empty:
        raise ConfigError(
            f"The model has no Gaussian in box '{roi.name}'.",
            "Give --model the scene's result.ply.",
        )
    return votes


def _make(
    args: argparse.Namespace,
    scene: SfmScene,
    roi: OrientedBox,
    rois: list[OrientedBox],
    scribbles: dict[str, Scribble],
    frame: LocalFrame,
    knowledge: Knowledge,
    context: Context,
) -> str:
    """Make the masks of one box; returns their folder."""
    from ..colmap.photo_pixels import photo_pixels
    from ..colmap.project import find_model
    from ..masking.box_masks import BoxMasks, masked_photos
    from ..masking.inputs import basis_digest
    from ..selection import SelectionConfig, select_cameras

    names = [*scribbles, *args.photo]
    if not args.photo:
        selection = select_cameras(scene, roi, SelectionConfig(), replace(context, emit=QUIET.emit))
        names = masked_photos(selection.names, selection.candidates, list(scribbles))
    folder = own_folder(args.out, roi.name)
    images = [image for image in scene.images if image.name in names]
    work = BoxMasks(
        scene=frame.scene(scene),
        roi=frame.box(roi),
        photos=photo_pixels(find_model(args.scene), images, context),
        strokes={name: scribble.strokes for name, scribble in scribbles.items()},
        folder=folder,
        basis=basis_digest(args.model, scene, roi, rois),
        anew=args.anew,
    )
    work.make(knowledge, context)
    return str(folder)
