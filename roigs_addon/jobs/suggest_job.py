"""Suggesting photos: the engine finds the most informative places; cameras are put there."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from ..engine import own_files
from ..engine.python import FOR_SUGGESTING, FOR_TRAINING
from ..engine.writing import made_folder
from ..properties import scene_props
from ..scene import suggestions
from ..shared import files, run_files, text
from . import options_files, run_folders
from .spec import SUGGESTING, JobSpec

LIST, PAGE = "suggestions.json", "suggestions.html"


def spec(scene: bpy.types.Scene, boxes: list[bpy.types.Object]) -> JobSpec:
    """The job that suggests photos of some boxes.

    Raises:
        AddonError: something is missing, or the run folder cannot be written to.
    """
    options = options_files.write_suggest_options(scene, boxes, model=_model(scene))
    out, find = made_folder(options.parent, own_files.SUGGESTED), run_folders.finder(scene)

    def take() -> str | None:
        now = find()
        if now is None:
            return None
        count = suggestions.show(now, out / LIST)
        return f"{text.counted(count, 'photo')} suggested, the best first"

    return JobSpec(
        title=SUGGESTING,
        arguments=["suggest", str(options), "--out", str(out)],
        log=own_files.log_file(run_folders.run_folder(scene)),
        on_done=take,
        is_so=lambda: (now := find()) is not None and suggestions.are_there(now),
    )


def packages(scene: bpy.types.Scene) -> tuple[str, ...]:
    """Packages that the engine's Python needs; a model, if there is one, draws the pictures."""
    return FOR_TRAINING if _model(scene) else FOR_SUGGESTING


def page(scene: bpy.types.Scene) -> Path | None:
    """The page with the suggestions, to print or for the phone; None: it is not there.

    A link in its place is not followed: the system opens what it is given as whatever it is.
    """
    page = run_folders.run_folder(scene) / own_files.OWN / own_files.SUGGESTED / PAGE
    return page if os.path.isfile(page) and not files.is_link(page) else None


def _model(scene: bpy.types.Scene) -> Path | None:
    """The result of the scene's training; None: there is none."""
    if not scene_props(scene).run_dir:
        return None
    result = run_folders.run_folder(scene) / run_files.RESULT
    return result if os.path.isfile(result) else None
