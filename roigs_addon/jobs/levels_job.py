"""Making levels of detail: the engine makes them in the scene's run folder."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..engine import own_files
from ..scene import compared
from ..shared import EngineError, levels
from ..windows import redraw
from . import options_files, run_folders
from .spec import LEVELS, JobSpec

DONE = "The 3D view and renders now use levels of detail"
NONE_KEPT = "No level looked good enough: the 3D view and renders use the whole result"


def spec(scene: bpy.types.Scene) -> JobSpec:
    """Return the job that makes levels of the last result, which is then shown.

    Raises:
        AddonError: the run folder cannot be written to.
    """
    folder, find = run_folders.settle(scene), run_folders.finder(scene)

    def show() -> str | None:
        now = find()
        if now is None:
            return None
        compared.show_last(now, folder)
        redraw()
        return None if _some_kept(folder) else NONE_KEPT

    return JobSpec(
        title=LEVELS,
        arguments=["levels", str(folder), *options_files.machine_options()],
        log=own_files.log_file(folder),
        folder=folder,
        on_done=show,
        done_text=DONE,
    )


def _some_kept(folder: Path) -> bool:
    """Whether a result has any level besides itself; the panel reports a damaged list."""
    try:
        return any(len(ladder.levels) > 1 for ladder in levels.read_ladders(folder).values())
    except EngineError:
        return True
