"""The names in a run folder (docs/files.md, section Run folder)."""

from __future__ import annotations

MANIFEST = "manifest.json"
"""What the run was made for: boxes, photos, settings."""
PROVENANCE = "provenance.json"
SPLIT = "split.json"
LOCK = "run.lock"
EVENTS = "events.jsonl"
ARCHIVE = "archive"
CACHE = "cache"
SELECTION = "selection"
"""Folder with a list of photos for each box."""

RESULT = "result.ply"
BACKGROUND = "background.ply"
"""The result without what lies in the boxes."""
FINE, COARSE = "rois", "coarse"
"""Folders with a PLY for each box: refined, and as the Scene-GS has it."""
PREVIEW = "preview.ply"
REPORT, REPORT_DATA, CROPS = "report.md", "report.json", "crops"

STAGE, MODEL, CHECKPOINT = "stage.json", "model.ply", "checkpoint.bin"
"""In a stage's folder: once it is done, and while it trains."""
SCENE_STAGE, JOINT_STAGE, REFINE_STAGE, OBJECT_STAGE = "scene", "joint", "refine", "object-"
"""Names of stages; the last is followed by the box's."""
