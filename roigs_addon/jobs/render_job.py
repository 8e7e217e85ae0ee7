"""Rendering: the engine draws the result along the scene's camera, Blender loads the picture."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..engine import own_files
from ..engine.writing import made_folder, writing
from ..scene.camera_path import camera_path
from ..shared import files, run_files
from . import options_files, run_folders
from .spec import RENDERING, JobSpec


def spec(scene: bpy.types.Scene, directory: str, *, animation: bool) -> JobSpec:
    """The job that renders the result.

    Args:
        scene: whose active camera is used.
        directory: where the pictures go; empty: into the run folder.
        animation: whether to render all frames of the scene's range.

    Raises:
        AddonError: the camera is of a kind that the engine cannot render, or the run folder cannot
            be written to.
    """
    folder = run_folders.run_folder(scene)
    cameras = camera_path(scene, animation=animation)
    path = made_folder(folder, own_files.OWN) / own_files.CAMERA_PATH
    with writing(folder, "Run Folder"):
        chosen = Path(bpy.path.abspath(directory)) if directory else None
        out = chosen or files.own_folder(folder, own_files.RENDERS)
        files.write_json(path, {"cameras": cameras})

    def load() -> None:
        picture = out / f"{cameras[0]['name']}.png"
        if picture.is_file():
            image = bpy.data.images.load(str(picture), check_existing=True)
            image.reload()

    result = str(folder / run_files.RESULT)
    where = ["--path", str(path), "--out", str(out)]
    return JobSpec(
        title=RENDERING,
        arguments=["render", result, *where, *options_files.machine_options()],
        log=own_files.log_file(folder),
        on_done=load,
        done_text=f"Rendered to {out}",
    )
