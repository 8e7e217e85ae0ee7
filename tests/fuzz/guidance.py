"""Families: commands that read a run folder beside a scene: certificates, suggestions, light.

The run's records and meshes are damaged, or something else is in their place.
"""

from __future__ import annotations

import functools
import json
import os
import random
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz import inputs
from tests.fuzz.cases import Case, good_boxes, good_scene, json_bytes, odd_tree, write
from tests.fuzz.damage import ODD_TEXTS, ODD_VALUES, bytes_damaged
from tests.fuzz.exchange import glb_of
from tests.fuzz.meshes import mesh_record, picture

CPU = ["--device", "cpu", "--threads", "1"]
SMALL = ["--max-side", "24", "--threads", "1"]
BOX = {
    "name": "thing",
    "world_to_box": np.eye(4).tolist(),
    "half_extents": [0.5, 0.5, 0.5],
}
ROW = {"model": "ours", "object_psnr": 27.5, "roi_psnr": 26.0, "object_ssim": 0.9, "lpips": 0.1}
RECORDS: dict[str, Any] = {
    "report.json": {"test_views": ["0.png"], "rois": [{"roi": "thing", "rows": [ROW]}]},
    "provenance.json": {
        "entries": [{"started": "2026-11-28T01:48:23+00:00", "versions": {"torch": "2.13.0"}}]
    },
    "split.json": {"evaluate_on": "test", "test": ["0.png"]},
    "manifest.json": {"version": 3, "sizes": ["48x36"], "photos": inputs.PHOTOS, "rois": [BOX]},
    "rois/thing.surface.json": {
        "box": "thing",
        "file": "rois/thing.glb",
        "result": "",
        "faces": 4,
        "vertices": 4,
        "parts": 1,
        "size": [1.0, 1.0, 1.0],
        "area": 1.0,
        "volume": None,
        "watertight": False,
        "filled": 0.0,
        "untextured": 0.0,
        "unseen": {"above": 0.1},
        "voxel": 0.01,
        "texture": 8,
        "photos": 3,
    },
}
REPORT = "<!DOCTYPE html>\n<h1>Report</h1>\n<script>1</script>\n"
MESHES = ("rois/thing.glb", "rois/background.glb")


@functools.cache
def models() -> dict[str, bytes]:
    """The models of a run, around its cameras and in its box."""
    from roigs_engine.model.gaussians import Gaussians

    dice = np.random.default_rng(4)
    ways = dice.normal(size=(300, 3))
    places = 3 * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    with tempfile.TemporaryDirectory(prefix="roigs-fuzz-") as name:
        file = Path(name, "a.ply")
        colours = dice.integers(0, 256, (len(places), 3)).astype(np.uint8)
        Gaussians.from_points(places, colours).save_ply(file)
        return dict.fromkeys(("result.ply", "background.ply", "rois/thing.ply"), file.read_bytes())


def run_folder(dice: random.Random, run: Path, scene: Path) -> None:
    """A run with a damaged record or mesh, or something else in the place of a file."""
    settings = {"scene": str(scene), "max_side": 24, "rois": str(scene / "rois.json")}
    trees = RECORDS | {"settings.json": settings}
    files = {**models(), **{name: json.dumps(tree).encode() for name, tree in trees.items()}}
    files |= dict.fromkeys(MESHES, glb_of(*mesh_record(picture())))
    files |= {"report.html": REPORT.encode(), "report.md": b"# Report\n"}
    for name in dice.sample(list(trees), dice.choice((1, 1, 2))):
        files[name] = json_bytes(dice, odd_tree(dice, trees[name]))
    if dice.random() < 0.3:
        name = dice.choice((*MESHES, "report.html", "rois/thing.ply", "result.ply"))
        files[name] = bytes_damaged(dice, files[name])
    for name, data in files.items():
        write(run / name, data)
    if dice.random() < 0.3:
        in_place(dice, run / dice.choice(list(files)))


def in_place(dice: random.Random, path: Path) -> None:
    """Something that is no file, or a link, in the place of one."""
    path.unlink()
    match dice.randrange(5):
        case 0:
            os.mkfifo(path)
        case 1:
            path.symlink_to("/dev/zero")
        case 2:
            path.symlink_to(path)
        case 3:
            path.mkdir()


def certify(dice: random.Random, folder: Path) -> Case:
    """Certificates with the numbers of a run."""
    scene, rois, out = good_scene(folder), good_boxes(folder), folder / "out"
    run_folder(dice, out / "run", scene)
    only = ["--only", "thing"] if dice.random() < 0.8 else []
    line = ["certify", str(scene), "--rois", rois, *only, "--run-dir", str(out / "run"), *SMALL]
    return Case([*line, "--out", str(out / "pages")])


def suggest(dice: random.Random, folder: Path) -> Case:
    """Suggestions beside a damaged placement of the scene, drawn by a damaged model."""
    scene, rois, out = good_scene(folder), good_boxes(folder), folder / "out"
    cameras = {name: [0.0, -1.0, float(k)] for k, name in enumerate(inputs.NAMES)}
    placed: Any = {"placements": [{"matrix": (2 * np.eye(4)).tolist(), "cameras": cameras}]}
    placed["placements"][0]["matrix"][3][3] = 1.0
    write(folder / "in" / "roigs_placement.json", json_bytes(dice, odd_tree(dice, placed)))
    if dice.random() < 0.2:
        in_place(dice, folder / "in" / "roigs_placement.json")
    line = ["suggest", str(scene), "--rois", rois, "--only", "thing", "--count", "1", *SMALL]
    if dice.random() < 0.3:
        data = bytes_damaged(dice, models()["result.ply"])
        line += ["--model", str(write(folder / "in" / "a.ply", data)), "--device", "cpu"]
    else:
        line += dice.choice(([], ["--no-look"]))
    return Case([*line, "--out", str(out)])


def panorama(dice: random.Random, folder: Path) -> Case:
    """The light in a run whose records or meshes are damaged, or at odd places."""
    scene, out = good_scene(folder), folder / "out"
    good_boxes(folder)
    run_folder(dice, out / "run", scene)
    at = dice.choice(("0,0,0",) * 12 + ("1e30,0,0", "nan,0,0", "1e308,1e308,1e308", "0,0", "a,b,c"))
    line = ["panorama", str(out / "run" / "result.ply"), f"--at={at}", "--width", "64", *CPU]
    line += dice.choice(([], [], ["--without", "thing"], [f"--without={dice.choice(ODD_TEXTS)}"]))
    line += dice.choice(([], [], [f"--near={dice.choice(('0.5', '1e300', 'nan', '-1'))}"]))
    name = dice.choice(("a.hdr",) * 5 + ("a.exr", "a.png", "run/a.hdr", ".hdr", "a\x1b[31m.hdr"))
    return Case([*line, "--out", str(out / name)])


def listed(dice: random.Random, folder: Path) -> Case:
    """The light of a list of models, as Blender writes it."""
    out, ply = folder / "out", write(folder / "in" / "a.ply", models()["result.ply"])
    tree: Any = {"models": [{"ply": str(ply), "matrix": np.eye(4).tolist()}]}
    if dice.random() < 0.3:
        tree["models"][0][dice.choice(("ply", "matrix", "exposure", "tint"))] = dice.choice(
            ODD_VALUES
        )
    path = write(folder / "in" / "list.json", json_bytes(dice, odd_tree(dice, tree)))
    line = ["panorama", str(path), "--at=0,0,0", "--width", "64", *CPU]
    return Case([*line, "--out", str(out / "a.hdr")])


def adapt(dice: random.Random, folder: Path) -> Case:
    """A model of a damaged run, which is made for another renderer."""
    scene, out = good_scene(folder), folder / "out"
    good_boxes(folder)
    run_folder(dice, out / "run", scene)
    line = [
        "adapt",
        str(out / "run" / "result.ply"),
        "--made-for",
        dice.choice(("plain", "cycles")),
    ]
    line += ["--steps", "1", *CPU, *dice.choice(([], [], ["--scene", str(scene)]))]
    return Case([*line, "--out", str(out / "adapted.ply")])


def confidence(dice: random.Random, folder: Path) -> Case:
    """Confidence of a damaged run's Gaussians, or of a damaged model's."""
    scene, out = good_scene(folder), folder / "out"
    good_boxes(folder)
    run_folder(dice, out / "run", scene)
    line = ["confidence", str(out / "run"), *CPU]
    if dice.random() < 0.3:
        data = bytes_damaged(dice, models()["result.ply"])
        line += ["--model", str(write(folder / "in" / "a.ply", data))]
    line += dice.choice(([], [], ["--scene", str(scene)], ["--heat-map"]))
    name = dice.choice(("a.ply", "a.npy", "a.txt", "run/result.ply", ".ply", "a\x1b[31m.npy"))
    return Case([*line, "--out", str(out / name)])


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "certify": (certify, 200),
    "suggest": (suggest, 100),
    "panorama": (panorama, 250),
    "panorama_list": (listed, 100),
    "adapt": (adapt, 150),
    "confidence": (confidence, 150),
}
