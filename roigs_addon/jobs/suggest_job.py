"""Checking photos and suggesting new ones: one command of the engine does both.

A check stores its results in the boxes; a suggestion also adds cameras for new photos.
"""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from ..engine import own_files
from ..engine.python import FOR_SUGGESTING, FOR_TRAINING
from ..engine.writing import made_folder
from ..properties import scene_props
from ..scene import checked, suggestions
from ..shared import files, run_files, text
from . import options_files, run_folders
from .spec import CHECKING, SUGGESTING, JobSpec

LIST, PAGE = "suggestions.json", "suggestions.html"


def spec(scene: bpy.types.Scene, boxes: list[bpy.types.Object], *, show: bool) -> JobSpec:
    """Return the job that checks the photos of some boxes and, with `show`, shows suggestions.

    Raises:
        AddonError: something is missing, or the run folder cannot be written to.
    """
    options = options_files.write_suggest_options(scene, boxes, model=_model(scene))
    out, find = made_folder(options.parent, own_files.SUGGESTED), run_folders.finder(scene)
    request, places = _request(options), checked.places_of(boxes, scene)

    def take() -> str | None:
        now = find()
        if now is None:
            return None
        checked.take(now, places, out / LIST, request)
        return in_words(suggestions.show(now, out / LIST)) if show else None

    return JobSpec(
        title=SUGGESTING if show else CHECKING,
        arguments=["suggest", str(options), "--out", str(out)],
        log=own_files.log_file(run_folders.run_folder(scene)),
        on_done=take,
        is_so=lambda: (now := find()) is not None and (not show or suggestions.are_there(now)),
    )


def in_words(count: int) -> str:
    """Describe the result: '3 photos suggested, the best first'."""
    return f"{text.counted(count, 'photo')} suggested, the best first"


def kept(scene: bpy.types.Scene, boxes: list[bpy.types.Object]) -> Path | None:
    """Return the engine's list if the last check had the same request and boxes, else None.

    Raises:
        AddonError: as `spec` does.
    """
    if not all(map(checked.of_box, boxes)):
        return None
    options = options_files.write_suggest_options(scene, boxes, model=_model(scene))
    listed = options.parent / own_files.SUGGESTED / LIST
    return listed if checked.is_fresh(scene, listed, _request(options)) else None


def packages(scene: bpy.types.Scene) -> tuple[str, ...]:
    """Return the packages that the engine needs; with a model, it draws the previews."""
    return FOR_TRAINING if _model(scene) else FOR_SUGGESTING


def page(scene: bpy.types.Scene) -> Path | None:
    """Return the page with the suggestions, to print or for the phone; None if it does not exist.

    A link in its place is not followed: the system would open its target, whatever it is.
    """
    page = run_folders.run_folder(scene) / own_files.OWN / own_files.SUGGESTED / PAGE
    return page if os.path.isfile(page) and not files.is_link(page) else None


def _request(options: Path) -> str:
    """Return a digest of the request: options, and boxes with their names and places."""
    asked = files.sha256(options), files.sha256(options.parent / own_files.ROIS)
    return text.json_digest(asked)


def _model(scene: bpy.types.Scene) -> Path | None:
    """Return the result of the scene's training; None if there is none."""
    if not scene_props(scene).run_dir:
        return None
    result = run_folders.run_folder(scene) / run_files.RESULT
    return result if os.path.isfile(result) else None
