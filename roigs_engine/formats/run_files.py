"""File names in a run folder (docs/files.md, section Run folder)."""

from __future__ import annotations

from pathlib import Path

MANIFEST = "manifest.json"  # the run's inputs: boxes, photos, settings
SETTINGS = "settings.json"  # the options of the request, as an options file
PROVENANCE = "provenance.json"
SPLIT = "split.json"
LOCK = "run.lock"
EVENTS = "events.jsonl"
STAGES, STAGES_FILE = "stages", "stages.json"
"""Parent of the stages' folders, `NAME-FINGERPRINT`; the list of the current settings' stages."""
EARLIER = "earlier"
"""Results of earlier settings: a folder for each, named after a hash of their manifest."""
CACHE, UNDISTORTED, MASKS = "cache", "undistorted", "masks"  # the last two are inside the first
EXPOSURES = "exposures.json"  # in the cache: photo -> correction of its exposure, stops
OBJECT_MASKS = "blender/masks"
"""Object masks that Blender could not write beside the photos, in a folder for each box."""
BOXES = "rois.json"  # the box that `--roi auto` found
PROJECT = "colmap"  # the COLMAP project, if the run starts from photos
SELECTION = "selection"  # folder with a list of photos for each box

RESULT = "result.ply"
BACKGROUND = "background.ply"  # the result without the boxes' content
FINE, COARSE = "rois", "coarse"
"""Folders with a PLY for each box: refined, and cut from the scene stage."""
SURROUNDINGS = "background"
"""Name of the mesh of the surroundings, beside the meshes of the boxes."""
PREVIEW = "preview.ply"
REPORT, REPORT_DATA, CROPS = "report.md", "report.json", "crops"
REPORT_PAGE = "report.html"
LEVELS, LEVELS_FILE = "levels", "levels.json"
"""Levels of detail: a folder for each, laid out as the run folder; the list of levels."""
LEVELS_MADE = "made.json"  # in `LEVELS`: file -> hashes of its inputs and of the file

STAGE, MODEL, CHECKPOINT = "stage.json", "model.ply", "checkpoint.bin"
"""Files in a stage's folder: the first two of a finished stage, the last one during training."""
SCENE_STAGE, JOINT_STAGE, REFINE_STAGE, OBJECT_STAGE = "scene", "joint", "refine", "object-"
"""Names of stages; the box's name follows the last one."""
CUTOUT_STAGE = "cutout"  # makes masked objects look right without their surroundings
SURFACE_STAGE = "surface"  # turns the result into a surface, only for meshes
FULL_SCENE_STAGE, FULL_OBJECT_STAGE = "full-scene", "full-object-"
"""Names of the baselines' stages; the box's name follows the last one."""
TUNED_STAGE, TUNED_COARSE_STAGE = "tuned-", "tuned-coarse-"  # `scene` or `object-NAME` follows
COMPARED = "compare-"
"""Prefix of a compared strategy's result folder and stages; the strategy's name follows."""

BATCH_LOCK, BATCH, BATCH_ROWS, BATCH_OUTPUTS = "batch.lock", "batch.json", "rows", "outputs"
"""In a batch's folder: its lock, its progress, a folder of options files, a folder of outputs."""
CLUSTER_OPTIONS, CLUSTER_LOCK = "cluster.json", "cluster.held"
"""Of a run on a cluster: its options file; the lock of the process that schedules its parts."""

RESULTS = (
    *(RESULT, BACKGROUND, FINE, COARSE),
    *(REPORT, REPORT_DATA, REPORT_PAGE, CROPS, LEVELS, LEVELS_FILE, SELECTION),
    *(SETTINGS, SPLIT, STAGES_FILE),
    *(f"{COMPARED}independent", f"{COMPARED}joint"),
)
"""Results of a run as a whole, not of one stage."""
_OTHERS = (
    *(MANIFEST, PROVENANCE, LOCK, EVENTS, BOXES, PREVIEW, PROJECT, CACHE),
    *(STAGES, EARLIER, CLUSTER_OPTIONS, CLUSTER_LOCK),
)
_NAMES = {*RESULTS, *_OTHERS}


_OF_BATCH = {BATCH_LOCK, BATCH, BATCH_ROWS, BATCH_OUTPUTS}


def is_of_batch(name: str) -> bool:
    """Whether a batch or a run writes a file or folder of that name; case is ignored.

    On a store, commits, leases and contents have names that begin with a dot.
    """
    return name.startswith(".") or name.casefold() in _OF_BATCH or is_own(name)


def is_own(name: str) -> bool:
    """Whether a run writes a file or folder of that name; case is ignored."""
    return name.casefold() in _NAMES


def mirrored(panorama: Path) -> Path:
    """The path of a panorama's variant for mirrors, without guessed lamps out of view."""
    return panorama.with_stem(f"{panorama.stem}-mirror")
