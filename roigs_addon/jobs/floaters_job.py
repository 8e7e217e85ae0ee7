"""Finding floaters: the engine looks at what is visible from the photos' places."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import leave_edit_mode, mesh_of, scene_of
from ..engine import own_files
from ..engine.writing import writing
from ..errors import AddonError
from ..geometry.splat_cloud import write_splats
from ..properties import scene_props
from ..scene import edits, lookup, point_edits, rois
from ..scene.splat_attributes import cloud_of, drawn
from ..settings import get as preferences
from ..shared import files
from . import options_files, run_folders
from .spec import FLOATERS, JobSpec

Mask = NDArray[np.bool_]
Found = dict[bpy.types.Object, Mask]

NAME = "roigs-floaters"
"""Of the files in Blender's temporary folder."""


def spec(context: bpy.types.Context, take: Callable[[Found], str]) -> JobSpec:
    """The job that finds floaters among what is visible.

    Args:
        context: its scene, and which objects are to be cleaned up.
        take: gets the objects to clean up and which of their points float; returns a line.

    Raises:
        AddonError: there is no model, there are no Gaussians, or files cannot be written.
    """
    scene = scene_of(context)
    colmap = options_files.colmap_folder(scene)
    leave_edit_mode(lookup.splats(scene))
    wanted = {mesh_of(item).session_uid for item in point_edits.checked_targets(context)}
    folder = Path(bpy.app.tempdir)
    out = folder / f"{NAME}.npy"
    with writing(folder, "temporary folder in Blender's preferences"):
        judged = [_written(item, scene, folder) for item in point_edits.visible(context)]
        listed, options = folder / f"{NAME}-models.json", folder / f"{NAME}.json"
        files.write_json(listed, {"models": [model for _, model in judged]}, durable=False)
        files.write_json(options, _options(scene, colmap, listed, folder), durable=False)
    looked_at = [(uid, state) for (uid, state), _ in judged]
    find = run_folders.finder(scene)

    def done() -> str | None:
        now = find()
        if now is None:
            return None
        return take({i: m for i, m in _of(now, looked_at, out).items() if _uid(i) in wanted})

    return JobSpec(
        title=FLOATERS,
        arguments=["floaters", str(options), "--out", str(out)],
        log=own_files.log_file(run_folders.settle(scene)),
        on_done=done,
    )


def _uid(item: bpy.types.Object) -> int:
    return int(mesh_of(item).session_uid)


def _written(
    item: bpy.types.Object, scene: bpy.types.Scene, folder: Path
) -> tuple[tuple[int, str], dict[str, Any]]:
    """The mesh and its state, and its Gaussians in a file with their place in the COLMAP frame."""
    mesh = mesh_of(item)
    found = cloud_of(mesh)
    if found is None:
        raise AddonError(f"'{item.name}' is no longer an object of Gaussians. Import it again.")
    cloud, applied = found
    path = folder / f"{NAME}-{mesh.session_uid}.ply"
    write_splats(path, cloud)
    root = np.linalg.inv(lookup.matrix_world(scene_props(scene).root))
    matrix = root @ lookup.matrix_world(item) @ applied
    return (_uid(item), edits.state_of(mesh)), {"ply": str(path), "matrix": matrix.tolist()}


def _options(scene: bpy.types.Scene, colmap: Path, listed: Path, folder: Path) -> dict[str, Any]:
    props, boxes = scene_props(scene), lookup.rois(scene)
    values = {
        "scene": str(colmap),
        "images": bpy.path.abspath(props.images) or None,
        "max_side": props.max_side,
        "exclude": options_files.excluded(scene) or None,
        "rois": str(rois.write(folder, boxes, scene)) if boxes else None,
        "threads": preferences().threads or None,
        "device": preferences().device,
        "model": str(listed),
    }
    return {key: value for key, value in values.items() if value is not None}


def _of(scene: bpy.types.Scene, looked_at: list[tuple[int, str]], out: Path) -> Found:
    """Object -> which of its points float; of those that share their points, the first."""
    try:
        every = np.load(out, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise AddonError(f"The engine's answer cannot be read ({error}).") from error
    items = {_uid(i): i for i in reversed(lookup.splats(scene)) if i.type == "MESH"}
    found: Found = {}
    begin = 0
    for uid, state in looked_at:
        item = items.get(uid)
        if item is None or edits.state_of(mesh_of(item)) != state:
            raise AddonError("The Gaussians were changed meanwhile. Find floaters again.")
        there = drawn(mesh_of(item))
        count = int(there.sum())
        if item not in found:
            found[item] = np.zeros(len(there), bool)
            found[item][there] = every[begin : begin + count]
        begin += count
    return found
