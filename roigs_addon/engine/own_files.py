"""The add-on's own files in a run folder, and names of stages for users. No bpy.

The engine's files are named in `roigs_engine.formats.run_files`.
"""

from __future__ import annotations

from pathlib import Path

from ..shared import run_files

CHECK, UNDISTORT, CAMERAS = "photos", "undistort", "refine cameras"
POINTS = "match points"
MASKING = "masks"
ADAPT, EVALUATE = "adapt", "evaluate"
SUGGEST = "suggest"
DEPTH, FUSION, MESH, FIT, TEXTURE = "depth", "fusion", "mesh", "fit", "texture"
LOOK, FEATURES, COMPARE = "look at photos", "features", "compare photos"
MATCHING, MAPPING = "matching", "mapping"
UNITS = {
    CHECK: "Photo",
    LOOK: "Photo",
    MASKING: "Photo",
    SUGGEST: "Box",
    FEATURES: "Photo",
    COMPARE: "Photo",
    DEPTH: "Photo",
    FIT: "Photo",
    MATCHING: "Pair",
}
"""Stage -> its unit of progress, if it does not count steps."""

OWN = "blender"
"""The add-on's own folder in a run folder; it contains all files below."""
LOG = f"{OWN}/engine.log"
TRAIN_OPTIONS, SELECT_OPTIONS, ROIS = "train.json", "select.json", "rois.json"
MASKS_OPTIONS, SCRIBBLES = "masks.json", "scribbles.json"
SUGGEST_OPTIONS, SUGGESTED = "suggest.json", "suggested"
IMPORTED = "imported"
"""Folder with imported Gaussians."""
MANUAL_SELECTION, SELECTED = "selection", "selected"
"""Folders with a list of photos per box: the user's for the engine, and the engine's own."""

BASELINES = ("full-", run_files.TUNED_STAGE, run_files.COMPARED)
"""Prefixes of stages that train other models for comparison."""
STAGE_WORDS = {
    run_files.SCENE_STAGE: "whole scene",
    run_files.JOINT_STAGE: "all boxes",
    run_files.REFINE_STAGE: "refining",
    run_files.CUTOUT_STAGE: "objects alone",
    run_files.SURFACE_STAGE: "surfaces",
    ADAPT: "adapting",
    EVALUATE: "measuring the result",
    DEPTH: "measuring depth",
    FUSION: "fusing depth",
    MESH: "making the mesh",
    FIT: "fitting to photos",
    CHECK: "checking photos",
    UNDISTORT: "undistorting photos",
    CAMERAS: "cameras",
    POINTS: "matching points",
    LOOK: "looking at photos",
    SUGGEST: "finding places",
    FEATURES: "finding features",
    COMPARE: "comparing photos",
    MATCHING: "matching photos",
    MAPPING: "placing photos",
}
"""Names of stages for the user."""


def stage_in_words(stage: str) -> str:
    """Return a stage's name for the user, as 'whole scene' for `scene`."""
    if stage.startswith(run_files.OBJECT_STAGE):
        return f"box '{stage.removeprefix(run_files.OBJECT_STAGE)}'"
    if stage.startswith(BASELINES):
        return "comparison"
    return STAGE_WORDS.get(stage, stage)


def step_in_words(stage: str, step: int, total: int) -> str:
    """Return a stage's progress, as 'Step 3 of 20', or in the stage's own unit."""
    share = f"{step:,} of {total:,}"
    if stage == MAPPING:
        return f"{share} photos registered"
    return f"{UNITS.get(stage, 'Step')} {share}"


def warning_in_words(text: str) -> str:
    """Replace a stage's name in a warning 'scene: …' by 'whole scene: …'; keep other warnings."""
    stage, colon, rest = text.partition(": ")
    return f"{stage_in_words(stage)}{colon}{rest}"


def log_file(folder: Path) -> Path:
    """Return the engine's log file in a run folder."""
    return folder / LOG
