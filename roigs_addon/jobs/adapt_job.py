"""Adapting: the engine trains the shown result a little for another renderer."""

from __future__ import annotations

import bpy

from ..engine import adapted_result, own_files, run_settings
from ..engine.writing import made_folder, writing
from ..errors import AddonError
from ..properties import scene_props
from ..scene import compared
from ..shared import run_files, targets
from ..windows import redraw
from . import options_files, run_folders
from .spec import ADAPTING, JobSpec

NAME = "adapted.ply"


def spec(scene: bpy.types.Scene, made_for: str) -> JobSpec:
    """Return the job that adapts it. The adapted result is stored with the earlier ones, and shown.

    Raises:
        AddonError: there is no model or no result, or the run folder cannot be written to.
    """
    colmap, source = options_files.colmap_folder(scene), compared.shown_result(scene)
    if source is None:
        raise AddonError("There is no result to adapt. Click Load Results first.")
    out = options_files.own_folder(scene) / NAME
    folder, find = run_folders.run_folder(scene), run_folders.finder(scene)
    title = targets.TARGETS[made_for].title

    def take() -> str | None:
        place = made_folder(folder, run_files.EARLIER, f"adapted-{made_for}")
        with writing(place, "Run Folder"):
            adapted_result.write(source, out, place)
            out.unlink()
        if now := find():
            compared.switch(now, place)
            redraw()
        return f"Adapted to {title}. Load Results shows the result as it was trained"

    arguments = ["adapt", str(source / run_files.RESULT), "--scene", str(colmap)]
    if images := scene_props(scene).images:
        arguments += ["--images", bpy.path.abspath(images)]
    side = run_settings.read(source).max_side or scene_props(scene).max_side
    arguments += ["--max-side", str(side), "--made-for", made_for, "--out", str(out)]
    return JobSpec(
        title=ADAPTING,
        arguments=[*arguments, *options_files.machine_options()],
        log=own_files.log_file(folder),
        folder=folder,
        on_done=take,
    )
