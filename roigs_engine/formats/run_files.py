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
"""A folder for each stage, `NAME-FINGERPRINT`, and the list of those of the present settings."""
EARLIER = "earlier"
"""Results of earlier settings: a folder for each, named after a hash of their manifest."""
CACHE, UNDISTORTED, MASKS = "cache", "undistorted", "masks"  # the last two are inside the first
EXPOSURES = "exposures.json"  # in the cache: photo -> stops by which it is levelled
OBJECT_MASKS = "blender/masks"
"""Masks of objects that Blender could not write beside the photos: a folder for each box."""
BOXES = "rois.json"  # the box of `--roi auto`
PROJECT = "colmap"  # the COLMAP project of a run of photos
SELECTION = "selection"  # folder with a list of photos for each box

RESULT = "result.ply"
BACKGROUND = "background.ply"  # the result without the boxes' content
FINE, COARSE = "rois", "coarse"
"""Folders with a PLY for each box: refined, and as the Scene-GS has it."""
SURROUNDINGS = "background"
"""Beside the boxes' meshes: the name of the mesh of all that is around them."""
PREVIEW = "preview.ply"
REPORT, REPORT_DATA, CROPS = "report.md", "report.json", "crops"
REPORT_PAGE = "report.html"
LEVELS, LEVELS_FILE = "levels", "levels.json"
"""Levels of detail: a folder for each, laid out as the run folder, and the list of them."""
LEVELS_MADE = "made.json"  # in the folder of levels: file -> hash of its inputs, and its own

STAGE, MODEL, CHECKPOINT = "stage.json", "model.ply", "checkpoint.bin"
"""In a stage's folder: once it is done, and while it trains."""
SCENE_STAGE, JOINT_STAGE, REFINE_STAGE, OBJECT_STAGE = "scene", "joint", "refine", "object-"
"""Names of stages; the last is followed by the box's."""
CUTOUT_STAGE = "cutout"  # makes objects with masks look right alone
SURFACE_STAGE = "surface"  # makes the result a surface, for a mesh alone
FULL_SCENE_STAGE, FULL_OBJECT_STAGE = "full-scene", "full-object-"
"""Names of the baselines' stages; the last is followed by the box's."""
TUNED_STAGE, TUNED_COARSE_STAGE = "tuned-", "tuned-coarse-"  # `scene` or `object-NAME` follows
COMPARED = "compare-"
"""Followed by the name of another strategy: the folder of its result, and of its stages' names."""

BATCH_LOCK, BATCH, BATCH_ROWS, BATCH_OUTPUTS = "batch.lock", "batch.json", "rows", "outputs"
"""In the folder of a batch: its lock, what is done, a folder of options files, one of outputs."""
CLUSTER_OPTIONS, CLUSTER_LOCK = "cluster.json", "cluster.held"
"""Of a run on a cluster: its options file; the lock of who gives out its parts."""

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
