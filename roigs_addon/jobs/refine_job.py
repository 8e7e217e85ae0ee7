"""Refining cameras: the engine writes a better model, then it is imported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import bpy

from .. import blender
from ..engine.python import FOR_READING, FOR_REFINING
from ..errors import AddonError
from ..properties import scene_props
from ..shared import projects
from . import import_job, options_files, run_folders
from .spec import REFINING, JobSpec

FIT_ALREADY = "The cameras fit already. Nothing was changed."
REFINED = "The cameras are refined."
FOUND = "The cameras were refined before, in {folder}. That model was imported."


def spec(scene: bpy.types.Scene) -> JobSpec:
    """Return the job that refines the cameras of the scene's model and imports the refined model.

    If there is a refined model already, the job only imports it.

    Raises:
        AddonError: the model is gone, or newer than its refined one; or the cache cannot be
            written to.
    """
    colmap = options_files.colmap_folder(scene)
    out = projects.refined_folder(colmap)
    if projects.is_refined_model(out):
        if projects.is_outdated(out):
            raise AddonError(f"{out} is older than the model. Delete it, then refine again.")
        return _importing(scene, out, FOUND.format(folder=out))
    find = run_folders.finder(scene)
    arguments = ["refine-cameras", str(colmap), "--out", str(out)]
    images = scene_props(scene).images
    if images:
        arguments += ["--images", str(blender.absolute(images))]

    def then(outputs: Mapping[str, str]) -> JobSpec | None:
        if "model" not in outputs:
            return None
        now = find()
        if now is None:
            raise AddonError(f"The scene is gone. Import its refined cameras from {out}.")
        return _importing(now, out, REFINED)

    return JobSpec(
        title=REFINING,
        arguments=arguments,
        log=import_job.made_export_folder(out) / import_job.LOG,
        then=then,
        done_text=FIT_ALREADY,
    )


def packages(scene: bpy.types.Scene) -> tuple[str, ...]:
    """Return the packages that the engine needs; only a few if a refined model exists."""
    out = projects.refined_folder(Path(scene_props(scene).colmap))
    return FOR_READING if projects.is_refined_model(out) else FOR_REFINING


def _importing(scene: bpy.types.Scene, folder: Path, done_text: str) -> JobSpec:
    images = scene_props(scene).images
    job = import_job.spec(scene, str(folder), images, same_frame=True)
    find = run_folders.finder(scene)

    def is_so() -> bool:
        now = find()
        return now is not None and scene_props(now).colmap == str(folder)

    return replace(job, title=REFINING, done_text=done_text, is_so=is_so)
