"""Training: the engine trains in the scene's run folder, then the Gaussians are imported."""

from __future__ import annotations

from pathlib import Path

import bpy

from .. import settings
from ..engine import own_files, run_status
from ..engine.run_status import RunStatus
from ..properties import scene_props
from ..scene import lookup, rois, splats
from ..windows import redraw
from . import options_files, run_folders
from .spec import TRAINING, JobSpec

WORDS = {
    "leave out --cluster": "choose Train On: This Computer",
    "--cluster": "Train On: Cluster",
}


def spec(scene: bpy.types.Scene, boxes: list[bpy.types.Object]) -> JobSpec:
    """Return the job that trains the scene and refines some boxes; with test photos, it measures.

    Raises:
        AddonError: something is missing, or the run folder cannot be written to.
    """
    measured = bool(scene_props(scene).test_every)
    seconds = 0.0 if bpy.app.background else settings.get().preview_seconds
    options = options_files.write_train_options(scene, boxes, seconds)
    folder, find = run_folders.run_folder(scene), run_folders.finder(scene)
    trained = rois.trained_names(scene, run_status.read(folder).boxes or {})
    splats.rename_boxes(scene, {old: new for new, old in trained.items()})

    def preview(path: Path) -> None:
        if now := find():
            splats.follow(now, folder)
            splats.show_preview(now, path)
        redraw()

    def take() -> None:
        if now := find():
            splats.show_results(now, folder)

    arguments = ["run" if measured else "train", str(options), "--run-dir", str(folder)]
    if address := settings.cluster():
        arguments += ["--cluster", address]
    return JobSpec(
        title=TRAINING,
        arguments=arguments,
        log=own_files.log_file(folder),
        folder=folder,
        on_preview=preview,
        on_done=take,
        words=WORDS,
    )


def boxes_to_resume(scene: bpy.types.Scene, status: RunStatus) -> list[bpy.types.Object]:
    """Return the boxes of the stopped training; all boxes if one of those is gone.

    With other boxes, the engine would train these again.
    """
    every = lookup.rois(scene)
    if not status.unfinished or not status.boxes:
        return every
    names = rois.trained_names(scene, status.boxes)
    theirs = [box for box in every if names.get(box.name, box.name) in status.boxes]
    return theirs if len(theirs) == len(status.boxes) else every
