"""Composes objects of trained models, cuts them out of their boxes, and finds floaters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError, RoiError
from ..formats.files import atomic_write, own_folder
from ..formats.mask_record import box_folders
from ..formats.projects import top_folder
from ..formats.run_files import BACKGROUND, FINE
from ..formats.splat_ply import check_ply
from ..formats.text import counted
from ..model.mask_coverage import with_useful_masks
from ..model.ownership import count_owned
from ..photos.mask_paths import MASKS, MaskOptions
from ..requests.models import Compose, Cut, Floaters
from .inputs import boxes_of, load_model, load_scene, on_device
from .instances import as_one, listed_models
from .outputs import Result, named_files, refuse_inputs, refuse_run_files

if TYPE_CHECKING:
    from torch import Tensor

    from ..model.roi import OrientedBox
    from ..model.scene import PosedImage, SfmScene


def compose(request: Compose, context: Context = QUIET) -> Result:
    """Replace a scene's Gaussians in boxes by those of object models; EngineError for bad input."""
    from ..model.gaussians import Gaussians
    from ..model.operations import merge

    refuse_run_files(request.out)
    by_name = {roi.name: roi for roi in boxes_of(request)}
    objects = named_files("--object", request.object, "ROI=FILE.ply")
    for name, path in objects.items():
        if name not in by_name:
            raise RoiError(
                f"--object {name}={path} does not name a box.",
                f"Write ROI=FILE.ply; the boxes are: {', '.join(by_name)}.",
            )
    if request.out.suffix.lower() != ".ply":
        raise ConfigError(f"--out {request.out} is not the name of a PLY.", "Write FILE.ply.")
    refuse_inputs([request.out], [request.scene_ply, *objects.values()])
    scene, frame = Gaussians.load_framed(request.scene_ply, context.check_cancelled, scaled=False)
    pairs = [
        (frame.box(by_name[name]), Gaussians.load_ply(path, frame, context.check_cancelled))
        for name, path in objects.items()
    ]
    for (roi, model), path in zip(pairs, objects.values(), strict=True):
        if not model.in_box(roi).any():
            raise RoiError(
                f"{path} has no Gaussian in box '{roi.name}'.", "Is it from the same scene?"
            )
    composed = merge(scene, pairs)
    context.check_cancelled()
    composed.save_ply(request.out, frame)
    text = f"{counted(len(composed), 'Gaussian')} in {request.out}"
    return Result(files={"result": request.out}, text=text)


# --- cut ---


def cut(request: Cut, context: Context = QUIET) -> Result:
    """Label the Gaussians of each box that has masks, and write the objects and the rest.

    EngineError: an input cannot be used, or no box has masks.
    """

    from ..model.local_frame import LocalFrame
    from ..training.labels import object_owners

    refuse_run_files(request.out)
    rois, rest = boxes_of(request), request.out / BACKGROUND
    files = {roi.name: own_folder(request.out, FINE) / f"{roi.name}.ply" for roi in rois}
    given = (request.options_file, request.rois, request.model)
    refuse_inputs([*files.values(), rest], given)
    check_ply(request.model)
    scene = _masked_scene(request, rois, context)
    frame, context = LocalFrame.of_scene(scene), on_device(context, request.device)
    model = load_model(request.model, frame, context)
    local, images = [frame.box(roi) for roi in rois], frame.scene(scene).images
    owner = object_owners(model, local, images, context)
    _say_owned(owner, count_owned(model, local), local, images, context)
    for index, roi in enumerate(rois):
        model.rows(owner == index).save_ply(files[roi.name], frame)
    model.rows(owner == -1).save_ply(rest, frame)
    return Result(files={"objects": request.out / FINE, "rest": rest}).with_places()


def _masked_scene(request: Cut, rois: Sequence[OrientedBox], context: Context) -> SfmScene:
    root, names = request.masks or top_folder(request.scene) / MASKS, [roi.name for roi in rois]
    if not any(box_folders(root, name)[0].is_dir() for name in names):
        raise ConfigError(
            f"{root} has no folder of masks for a box ({', '.join(names)}).",
            f"Put masks into {root / names[0]}, or give --masks the folder above it.",
        )
    inverted = request.invert_masks
    masks = MaskOptions(folder=root, used=False, boxes=tuple(names), objects_inverted=inverted)
    scene = with_useful_masks(load_scene(request, context, masks=masks), rois, context)
    if not any(image.objects for image in scene.images):
        raise ConfigError(
            f"No mask in {root} shows an object.",
            "The mask of the photo 012.jpg is 012.jpg.png: the object white, the rest black.",
        )
    return scene


def _say_owned(
    owner: Tensor,
    owned: Sequence[int],
    rois: Sequence[OrientedBox],
    images: Sequence[PosedImage],
    context: Context,
) -> None:
    """Report for each box how many of its Gaussians are the object's."""
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


# --- floaters ---


def find_floaters(request: Floaters, context: Context = QUIET) -> Result:
    """Find Gaussians in the air in a model, by the rule at the end of a training.

    EngineError: an input cannot be used.
    """
    import torch

    from ..model.local_frame import LocalFrame
    from ..training.floaters import floaters

    refuse_run_files(request.out)
    wanted = listed_models(request.model)
    given = (request.options_file, request.rois, request.model)
    refuse_inputs([request.out], [*given, *(Path(item.file) for item in wanted)])
    rois, scene = boxes_of(request, required=False), load_scene(request, context)
    frame = LocalFrame.of_scene(scene)
    local = frame.scene(scene)
    model, there = as_one(wanted, frame, context)
    context = on_device(context, request.device)
    found = np.zeros(len(there), bool)
    if len(model):
        judged = floaters(
            model.to(torch.device(context.device)),
            local.images,
            [frame.box(roi) for roi in rois],
            local.points,
            request.min_views,
            context,
        )
        found[there] = judged.cpu().numpy()
    with atomic_write(request.out) as file:
        np.save(file, found)
    text = f"{counted(int(found.sum()), 'floater')} among {len(found):,} Gaussians"
    return Result(files={"floaters": request.out}, text=text)
