"""Selecting photos: the engine writes lists into the run folder, and the boxes read them."""

from __future__ import annotations

import bpy

from ..engine import own_files
from ..engine.python import FOR_GAUSSIAN_PROCESS, FOR_READING
from ..engine.writing import made_folder
from ..properties import scene_props
from ..scene import lookup, selections
from . import options_files, run_folders
from .spec import SELECTING, JobSpec

GAUSSIAN_PROCESS = ("gp6", "gp9")


def spec(scene: bpy.types.Scene, boxes: list[bpy.types.Object]) -> JobSpec:
    """Return the job that selects the photos of some boxes.

    Raises:
        AddonError: something is missing, or the run folder cannot be written to.
    """
    options = options_files.write_select_options(scene, boxes)
    out = made_folder(options.parent, own_files.SELECTED)
    names, find = {box.name for box in boxes}, run_folders.finder(scene)

    def take() -> None:
        if now := find():
            for box in lookup.rois(now):
                if box.name in names:
                    selections.take_selection(box, now, out / f"{box.name}.json")

    return JobSpec(
        title=SELECTING,
        arguments=["select", str(options), "--out", str(out)],
        log=own_files.log_file(run_folders.run_folder(scene)),
        on_done=take,
    )


def packages(scene: bpy.types.Scene) -> tuple[str, ...]:
    """Return the packages that the engine's Python needs for the scene's method."""
    needs_gp = scene_props(scene).method in GAUSSIAN_PROCESS
    return FOR_GAUSSIAN_PROCESS if needs_gp else FOR_READING
