"""Making levels of detail: the engine makes them in the scene's run folder."""

from __future__ import annotations

import bpy

from ..engine import own_files
from ..scene import compared, splats
from ..windows import redraw
from . import options_files, run_folders
from .spec import LEVELS, JobSpec

DONE = "The 3D view and renders now use levels of detail"


def spec(scene: bpy.types.Scene) -> JobSpec:
    """The job that makes them of the last result, which is then shown.

    Raises:
        AddonError: the run folder cannot be written to.
    """
    folder, find = run_folders.settle(scene), run_folders.finder(scene)

    def show() -> None:
        now = find()
        if now is None:
            return
        shown = compared.shown_result(now)
        if shown is None:
            splats.show_results(now, folder)
        elif shown != folder:
            compared.switch(now, folder)
        redraw()

    return JobSpec(
        title=LEVELS,
        arguments=["levels", str(folder), *options_files.machine_options()],
        log=own_files.log_file(folder),
        folder=folder,
        on_done=show,
        done_text=DONE,
    )
