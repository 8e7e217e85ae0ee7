"""Importing a COLMAP model: the engine exports it to the cache, then objects are built."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import bpy

from .. import blender, settings
from ..engine.writing import writing
from ..errors import AddonError
from ..properties import scene_props
from ..scene import importing, selections
from ..shared import projects
from . import current, run_folders
from .spec import IMPORTING, JobSpec

LOG = "engine.log"


def spec(scene: bpy.types.Scene, chosen: str, images: str, *, same_frame: bool = False) -> JobSpec:
    """Return the job that imports a model.

    Args:
        scene: to import into.
        chosen: the folder of a COLMAP project, or a file in it.
        images: the folder of its photos; empty to find it.
        same_frame: see `importing.import_folder`.

    Raises:
        AddonError: there is no such folder, its path is relative to a .blend that was never
            saved, or the cache cannot be written to.
    """
    folder = blender.absolute(chosen)
    if os.path.isfile(folder):
        folder = folder.parent
    if not os.path.isdir(folder):
        raise AddonError(f"There is no folder {folder}. Choose the folder of a COLMAP project.")
    out = made_export_folder(folder)
    find = run_folders.finder(scene)
    arguments = ["export", str(folder), "--out", str(out)]
    if images:
        arguments += ["--images", str(blender.absolute(images))]

    def build() -> None:
        now = find()
        if now is None:
            return
        lost = importing.import_folder(now, out, project_name(folder), same_frame=same_frame)
        if lost:
            current.warn(lost)
        selections.mark_chosen(now)
        _hide_relationship_lines()
        scene_props(now).colmap, scene_props(now).images = str(folder), images

    return JobSpec(title=IMPORTING, arguments=arguments, log=out / LOG, on_done=build)


def project_name(folder: Path) -> str:
    """Return the name of a COLMAP project's folder."""
    return project_folder(folder).name


def project_folder(folder: Path) -> Path:
    """Return a COLMAP project's folder; `folder` may be its `sparse`, `sparse/0` or `images`."""
    return projects.top_folder(folder)


def export_folder(colmap: Path) -> Path:
    """Return the cache folder of a model's exported files; each model path has its own."""
    key = hashlib.sha256(str(colmap.resolve()).encode()).hexdigest()[:16]
    return settings.models_folder() / key


def made_export_folder(colmap: Path) -> Path:
    """Return the export folder, created if it is missing.

    Raises:
        AddonError: the cache cannot be written to.
    """
    out = export_folder(colmap)
    with writing(out, "Cache Folder in the add-on's preferences"):
        out.mkdir(parents=True, exist_ok=True)
    return out


def _hide_relationship_lines() -> None:
    """Hide them in 3D views: lines from a thousand cameras to the root would cover everything."""
    for area in blender.areas("VIEW_3D"):
        view = area.spaces.active
        if isinstance(view, bpy.types.SpaceView3D):
            view.overlay.show_relationship_lines = False
