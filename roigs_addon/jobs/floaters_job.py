"""Finding floaters: the engine checks the visible Gaussians from the photos' places."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import scene_of
from ..engine import own_files
from ..engine.writing import writing
from ..properties import scene_props
from ..scene import lookup, rois
from ..settings import get as preferences
from ..shared import files
from . import options_files, run_folders
from .judged import FOLDER, Judged
from .spec import FLOATERS, JobSpec

Mask = NDArray[np.bool_]
Found = dict[bpy.types.Object, Mask]

NAME = "roigs-floaters"
"""Prefix of file names in Blender's temporary folder."""


def spec(context: bpy.types.Context, take: Callable[[Found], str]) -> JobSpec:
    """Return the job that finds floaters among visible Gaussians.

    Args:
        context: gives the scene and the objects to clean up.
        take: gets these objects with masks of their floaters; returns a line for the user.

    Raises:
        AddonError: there is no model, there are no Gaussians, or files cannot be written.
    """
    scene = scene_of(context)
    colmap = options_files.colmap_folder(scene)
    judged = Judged.write(context, NAME)
    options = judged.listed.with_name(f"{NAME}.json")
    with writing(options.parent, FOLDER):
        files.write_json(options, _options(scene, colmap, judged.listed), durable=False)
    find = run_folders.finder(scene)

    def done() -> str | None:
        now = find()
        return None if now is None else take(judged.rows(now, False, "Find floaters again."))

    return JobSpec(
        title=FLOATERS,
        arguments=["floaters", str(options), "--out", str(judged.out)],
        log=own_files.log_file(run_folders.settle(scene)),
        on_done=done,
    )


def _options(scene: bpy.types.Scene, colmap: Path, listed: Path) -> dict[str, Any]:
    props, boxes = scene_props(scene), lookup.rois(scene)
    values = {
        "scene": str(colmap),
        "images": bpy.path.abspath(props.images) or None,
        "max_side": props.max_side,
        "exclude": options_files.excluded(scene) or None,
        "rois": str(rois.write(listed.parent, boxes, scene)) if boxes else None,
        "threads": preferences().threads or None,
        "device": preferences().device,
        "model": str(listed),
    }
    return {key: value for key, value in values.items() if value is not None}
