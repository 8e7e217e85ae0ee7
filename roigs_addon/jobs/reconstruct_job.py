"""Reconstructing: the engine makes a COLMAP project from photos, then it is imported."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import bpy

from ..blender import absolute, full_path, stored
from ..engine import reconstruction
from ..errors import AddonError
from ..properties import scene_props
from ..shared import projects
from . import import_job, options_files, run_folders
from .spec import RECONSTRUCTING, JobSpec

NO_PHOTOS = "Choose the folder of the photos first."
FOLDER = "Project Folder"
MOST_TRIED = 100
"""Most names tried for a new folder; if none is usable, the engine reports why."""
MASKS = "masks"
"""Folder beside the photos."""
WORDS = {"--out": FOLDER, "--run-dir": FOLDER, "--masks": "Masks"}


def spec(scene: bpy.types.Scene) -> JobSpec:
    """Return the job that reconstructs the scene's photos and imports the model.

    Raises:
        AddonError: there is no folder of photos, or the cache cannot be written to.
    """
    props = scene_props(scene)
    if not props.photos:
        raise AddonError(NO_PHOTOS)
    for path in (props.photos, props.project, props.masks):
        stored(path)  # may raise, so panels do not call it
    photos, project = photos_folder(props.photos), project_folder(scene)
    masks = masks_folder(scene)
    log = import_job.made_export_folder(project) / import_job.LOG
    # The .blend stores both, so that Continue finds them.
    _keep(scene, photos, project)
    find = run_folders.finder(scene)

    def then(_: Mapping[str, str]) -> JobSpec:
        now = find()
        if now is None:
            raise AddonError(f"The scene is gone. Import the model from {project}.")
        _keep(now, photos, project)
        done_text = reconstruction.read(project).summary
        job = import_job.spec(now, str(project), "")
        return replace(job, title=RECONSTRUCTING, done_text=done_text)

    return JobSpec(
        title=RECONSTRUCTING,
        arguments=[
            *("reconstruct", str(photos), "--out", str(project)),
            *("--max-side", str(props.feature_side)),
            *("--pairs", props.pairs, "--cameras", props.shared_cameras),
            *(("--masks", str(masks)) if masks else ()),
            *options_files.threads_option(),
        ],
        log=log,
        then=then,
        words=WORDS,
    )


def _keep(scene: bpy.types.Scene, photos: Path, project: Path) -> None:
    """Store both folders, and keep the masks: setting photos clears settings of earlier ones."""
    props = scene_props(scene)
    if props.photos != str(photos):
        masks = props.masks
        props.photos, props.masks = str(photos), masks
    props.project = str(project)


def photos_folder(chosen: str) -> Path:
    """Return the chosen folder, the folder of a chosen photo, or a chosen video itself.

    Raises:
        AddonError: there is no such folder, or its path is relative to a .blend never saved.
    """
    folder = absolute(chosen)
    if os.path.isfile(folder):
        if is_video(folder):
            return folder
        folder = folder.parent
    if not os.path.isdir(folder):
        raise AddonError(f"There is no folder {folder}. Choose the folder of the photos.")
    return folder


def is_video(path: Path) -> bool:
    """Whether a path names a video, by its ending."""
    return path.suffix.lower() in projects.VIDEOS and not os.path.isdir(path)


def project_folder(scene: bpy.types.Scene) -> Path:
    """Return the folder of the scene's reconstruction, or the one that it would get."""
    props = scene_props(scene)
    return full_path(props.project) if props.project else proposed(full_path(props.photos))


def masks_folder(scene: bpy.types.Scene) -> Path | None:
    """Return the folder of the photos' masks: the scene's, or one beside the photos, if any."""
    props = scene_props(scene)
    if props.masks:
        return full_path(props.masks)
    beside = full_path(props.photos).parent / MASKS
    return beside if os.path.isdir(beside) else None


def proposed(photos: Path) -> Path:
    """Return a folder beside the photos or the video that is free or has a reconstruction.

    It is named after the photos' folder. If that is called `images`, as in COLMAP projects, it is
    named after the folder above.
    """
    named = photos.parent if photos.name.lower().startswith("images") else photos
    name = f"{(named.stem if is_video(named) else named.name) or 'photos'}_colmap"
    names = itertools.chain([name], (f"{name}-{number}" for number in itertools.count(2)))
    folders = (photos.parent / name for name in itertools.islice(names, MOST_TRIED))
    return next((f for f in folders if reconstruction.is_free(f)), photos.parent / name)
