"""Family: run folders that have files of others, under names of a run's and under their own."""

from __future__ import annotations

import random
from pathlib import Path

from roigs_engine.formats import run_files
from tests.fuzz.cases import QUICK, Case, Family, good_boxes, good_scene, write

NAMES = (
    *(name for name in run_files.RESULTS if "." in name),
    *(run_files.PREVIEW, run_files.PROVENANCE, run_files.MANIFEST, "batch.json", "rois.json"),
    *("rois/thing.ply", "coarse/thing.ply", "selection/thing.json", "crops/thing/overview.png"),
    *("poetry.lock", "uv.lock", "scene.lock", "joint.lock", "notes.txt", "cache/mine.png"),
    *("cache/undistorted/mine.png", "stages/mine.txt", "earlier/mine.txt", "x/y.bin"),
)
TEXTS = ("mine", "{}", "[]", '{"name": "mine"}', '{"version": 1}', '{"pid": 5}', '{"test": []}', "")


def foreign_folders(dice: random.Random, folder: Path) -> Case:
    """A run in a folder with files of the user's, all of which stay."""
    names = dice.sample(NAMES, dice.choice((1, 1, 2, 4)))
    for name in names:
        write(folder / "out" / name, dice.choice(TEXTS))
    run = ["--rois", good_boxes(folder), "--run-dir", str(folder / "out"), *QUICK]
    command = ["claim", str(good_scene(folder)), *run]
    return Case(command, keeps=tuple(f"out/{name}" for name in names))


FAMILIES: dict[str, tuple[Family, int]] = {"foreign_folders": (foreign_folders, 200)}
