"""The names in a run folder that the add-on uses (docs/files.md, section Run folder). No bpy."""

from __future__ import annotations

from pathlib import Path

MANIFEST = "manifest.json"
"""What the run was made for: boxes, photos, settings."""
LOCK = "run.lock"
RESULT = "result.ply"
BACKGROUND = "background.ply"
"""The result without what lies in the boxes."""
FINE, COARSE = "rois", "coarse"
"""Folders with a PLY for each box: refined, and as the whole-scene model has it."""
STAGE_DONE = "*/stage.json"
STAGE_LEFT = "*/checkpoint*.bin"
RENDERS = "renders"

WHOLE_SCENE, ALL_BOXES, REFINING, UNDISTORT = "scene", "joint", "refine", "undistort"
ONE_BOX = "object-"
"""Stages; the last one is followed by the box's name."""

OWN = "blender"
"""The add-on's own folder in it; all that follows is in there."""
LOG = f"{OWN}/engine.log"
TRAIN_OPTIONS, SELECT_OPTIONS, ROIS = "train.json", "select.json", "rois.json"
CAMERA_PATH = "path.json"
MANUAL_SELECTION, SELECTED = "selection", "selected"
"""Folders with a list of photos for each box: given to the engine, and chosen by it."""


def stage_in_words(stage: str) -> str:
    """'whole scene' for `scene`."""
    words = {
        WHOLE_SCENE: "whole scene",
        ALL_BOXES: "all boxes",
        REFINING: "refining",
        UNDISTORT: "undistorting photos",
    }
    if stage.startswith(ONE_BOX):
        return f"box '{stage.removeprefix(ONE_BOX)}'"
    return words.get(stage, stage)


def log_file(folder: Path) -> Path:
    """Where the engine's words go."""
    return folder / LOG
