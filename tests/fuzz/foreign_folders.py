"""Family: folders that have files of others, under names of ours and under their own."""

from __future__ import annotations

import random
from pathlib import Path

from roigs_engine.formats import run_files
from tests.fuzz.cases import QUICK, Case, Family, good_boxes, good_photos, good_scene, write

NAMES = (
    *(name for name in run_files.RESULTS if "." in name),
    *(run_files.PREVIEW, run_files.PROVENANCE, run_files.MANIFEST, "batch.json", "rois.json"),
    *("rois/thing.ply", "coarse/thing.ply", "selection/thing.json", "crops/thing/overview.png"),
    *("poetry.lock", "uv.lock", "scene.lock", "joint.lock", "notes.txt", "cache/mine.png"),
    *("cache/undistorted/mine.png", "stages/mine.txt", "earlier/mine.txt", "x/y.bin"),
)
OF_A_RUN = ("run.lock", "events.jsonl", "cluster.json", "cache/photos.json", "cache/exposures.json")
OF_A_RECONSTRUCTION = (
    *("reconstruction.md", "database.db", "database.db-wal", "reconstruction/run.lock"),
    *(f"reconstruction/{name}" for name in ("state.json", "photos.json", "log.txt", "notes.txt")),
    *(
        f"reconstruction/{name}"
        for name in ("converted.json", "models/a", "earlier/0", "video.json")
    ),
    *("sparse/mine.txt", "images/mine.txt", "rois.json"),
)
TEXTS = ("mine", "{}", "[]", '{"name": "mine"}', '{"version": 1}', '{"pid": 5}', '{"test": []}', "")


def foreign_folders(dice: random.Random, folder: Path) -> Case:
    """A run, or a reconstruction, in a folder with files of the user's, all of which stay."""
    if dice.random() < 0.4:
        return _reconstruction(dice, folder)
    names = dice.sample((*NAMES, *OF_A_RUN, *OF_A_RUN), dice.choice((1, 1, 2, 4)))
    for name in names:  # an empty lock or log holds nothing of anybody
        write(folder / "out" / name, dice.choice(TEXTS[:-1] if name in OF_A_RUN else TEXTS))
    run = ["--rois", good_boxes(folder), "--run-dir", str(folder / "out"), *QUICK]
    command = ["claim", str(good_scene(folder)), *run]
    return Case(command, keeps=tuple(f"out/{name}" for name in names))


def _reconstruction(dice: random.Random, folder: Path) -> Case:
    for name, data in good_photos().items():
        write(folder / "in" / "photos" / name, data)
    names = dice.sample(OF_A_RECONSTRUCTION, dice.choice((1, 1, 2, 4)))
    for name in names:
        write(folder / "out" / "scene" / name, dice.choice(TEXTS[:-1]))
    return Case(
        ["resume", str(folder / "out" / "scene")],
        keeps=tuple(f"out/scene/{name}" for name in names),
    )


FAMILIES: dict[str, tuple[Family, int]] = {"foreign_folders": (foreign_folders, 200)}
