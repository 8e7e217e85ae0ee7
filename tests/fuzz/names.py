"""Families: hostile names in every format that carries names, and folders of the user's among ours.

Nothing outside the case is touched, no file of the input changes, and the user's files stay.
"""

from __future__ import annotations

import copy
import json
import os
import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fuzz import exchange, inputs, levels_and_scribbles
from tests.fuzz.cases import (
    QUICK,
    Case,
    good_boxes,
    good_scene,
    json_bytes,
    odd_tree,
    write,
    write_scene,
)
from tests.fuzz.damage import ODD_VALUES
from tests.fuzz.masks import mask
from tests.fuzz.run_folders import run_files
from tests.fuzz.stores import HOSTILE, on_store

CPU = ["--device", "cpu", "--threads", "1"]


def hostile(dice: random.Random, folder: Path) -> str:
    """A name that leads somewhere, often to a file that lies beside the case's output."""
    victim = write(folder / "in" / "mine.txt", b"of the user's")
    absolute = (str(victim), victim.as_uri(), "../in/mine.txt", "../../in/mine.txt", "..\\in\\x")
    return dice.choice((*absolute, *absolute, *HOSTILE))


def photos(dice: random.Random, folder: Path) -> Case:
    """Photos of a COLMAP model, as text and binary."""
    tree = inputs.model()
    for image in dice.sample(tree["images"], dice.choice((1, 1, 2))):
        image[3] = hostile(dice, folder)
    files = dice.choice((inputs.text_files, inputs.binary_files))(tree)
    write_scene(folder / "in", files, {name: inputs.photo() for name in inputs.NAMES})
    scene, rois, out = str(folder / "in"), good_boxes(folder), str(folder / "out")
    asked = dice.choice(("inspect", "decode", "export", "select", "claim", "masks"))
    line = [asked, scene]
    line += ["--rois", rois] if asked in ("inspect", "select", "claim", "masks") else []
    if asked == "masks":
        strokes = [levels_and_scribbles.scribble(dice, image[3]) for image in tree["images"]]
        text = json.dumps({"scribbles": strokes}).encode("utf-8", "surrogatepass")
        line += ["--scribbles", str(write(folder / "in" / "strokes.json", text)), *CPU]
    place = {"claim": "--run-dir", "inspect": "", "decode": ""}.get(asked, "--out")
    return Case([*line, *([place, out] if place else [])])


def levels(dice: random.Random, folder: Path) -> Case:
    """The PLYs of `levels.json`, its boxes, and the record of what levels were made of."""
    scene, out = good_scene(folder), folder / "out"
    files = levels_and_scribbles.run_files() | {
        "settings.json": json.dumps({"scene": str(scene)}).encode()
    }
    for name, data in files.items():
        write(out / name, data)
    tree = json.loads(files["levels.json"])
    part = dice.choice(tree["parts"])
    home, key = dice.choice(((part, "box"), (part["levels"][0], "ply"), (part["levels"][1], "ply")))
    home[key] = hostile(dice, folder)
    write(out / "levels.json", json.dumps(tree).encode("utf-8", "surrogatepass"))
    made = {hostile(dice, folder): "0" * 64 for _ in range(2)}
    write(out / "levels/made.json", json.dumps(made).encode("utf-8", "surrogatepass"))
    if dice.random() < 0.3:
        return Case(["levels", str(out), *levels_and_scribbles.MAKE])
    cameras = str(write(folder / "in" / "path.json", json.dumps(inputs.camera_path())))
    line = ["render", str(out / "result.ply"), "--path", cameras, "--levels", *CPU]
    return Case([*line, "--out", str(out / "pictures")])


def made_masks(dice: random.Random, folder: Path) -> Case:
    """The record of masks that were made, and the photos of strokes."""
    scene, rois, out = good_scene(folder), good_boxes(folder), folder / "out"
    strokes = [levels_and_scribbles.scribble(dice, name) for name in inputs.NAMES[:2]]
    if dice.random() < 0.5:
        strokes[1][dice.choice(("photo", "box"))] = hostile(dice, folder)
    text = json.dumps({"scribbles": strokes})
    path = str(write(folder / "in" / "strokes.json", text.encode("utf-8", "surrogatepass")))
    mine = write(out / "thing" / "mine.png", mask(dice))
    from roigs_engine.formats.files import sha256

    names = {hostile(dice, folder): "0" * 64, "../mine.png": sha256(mine)}
    record = {"masks": names, "writing": dict(names), "inputs": {}}
    write(out / "thing" / "made.json", json.dumps(record).encode("utf-8", "surrogatepass"))
    line = ["masks", str(scene), "--rois", rois, "--scribbles", path, "--out", str(out), *CPU]
    return Case(line, keeps=("out/thing/mine.png",))


def packed(dice: random.Random, folder: Path) -> Case:
    """URIs of a GLB, files of a SOG and of its ZIP, and folders of a streamed SOG."""
    name = hostile(dice, folder)
    match dice.randrange(3):
        case 0:
            record, blob = exchange.glb_parts(exchange.good(".glb", 1))
            record["buffers"][0]["uri"] = name
            record["images"] = [{"uri": name}]
            if dice.random() < 0.5:
                text = json.dumps(record).encode()
                return exchange.converted(dice, folder, ".gltf", text)
            return exchange.converted(dice, folder, ".glb", exchange.glb_of(record, blob))
        case 1:
            files = exchange.unzipped(exchange.good(".sog", 1))
            meta = json.loads(files["meta.json"])
            part = dice.choice([key for key, value in meta.items() if "files" in str(value)])
            named = meta[part]["files"]
            at = dice.randrange(len(named))
            files[name.encode("utf-8", "replace").decode()[:60000] or "x"] = files.pop(named[at])
            named[at] = name
            files["meta.json"] = json.dumps(meta).encode()
            if dice.random() < 0.5:  # without its pictures
                source = write(folder / "in" / "meta.json", files["meta.json"])
                return Case(["convert", str(source), str(folder / "out" / "b.ply")])
            return exchange.converted(dice, folder, ".sog", exchange.zipped(files))
        case _:
            out = folder / "out"
            for place in ("0_0", "1_2", "mine_1"):
                meta = {"asset": {"generator": "ROI-GS for Blender"}, "means": {"files": [name]}}
                text = json.dumps(meta).encode("utf-8", "surrogatepass")
                write(out / place / "meta.json", text)
                write(out / place / "mine.txt", b"of the user's")
            record = {"filenames": [name, "0_0/meta.json"]}
            text = json.dumps(record).encode("utf-8", "surrogatepass")
            write(out / "lod-meta.json", text)
            source = str(write(folder / "in" / "a.ply", exchange.good(".ply", 1)))
            keeps = tuple(f"out/{place}/mine.txt" for place in ("0_0", "1_2", "mine_1"))
            return Case(["convert", source, str(out / "lod-meta.json")], keeps=keeps)


def lists(dice: random.Random, folder: Path) -> Case:
    """Lists of models, tables, options files, selections and camera paths."""
    scene, rois, out = good_scene(folder), good_boxes(folder), str(folder / "out")
    name = hostile(dice, folder)
    home = folder / "in"
    ply = str(write(home / "a.ply", inputs.good_ply()))
    match dice.randrange(6):
        case 0:
            row = {"file": name, "name": name, "matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}
            tree: Any = {"models": [{**row, "file": "a.ply"}, row]}
            line = ["convert", str(home / "list.json"), f"{out}/b.ply"]
        case 1:
            text = f"[scenes.{json.dumps(name)}]\nscene = {json.dumps(str(scene))}\n"
            text += f"rois = {json.dumps(rois)}\noutputs = [{json.dumps(name)}]\n"
            table = write(home / "museum.toml", text.encode("utf-8", "surrogatepass"))
            return Case(["batch", str(table), "--run-dir", out], statuses=(2,))
        case 2:  # what a batch writes beside its run folders
            key = dice.choice(("outputs", "object_outputs"))
            begin, end = dice.choice(("", "/", ".")), dice.choice((".ply", ".spz", "ply"))
            ending = json.dumps(f"{begin}x{name}{end}")
            text = f"[scenes.hall]\nscene = {json.dumps(str(scene))}\n"
            text += f"rois = {json.dumps(rois)}\n{key} = [{ending}]\n"
            table = write(home / "museum.toml", text.encode("utf-8", "surrogatepass"))
            return Case(["batch", str(table), "--run-dir", out, "--dry-run"], statuses=(2,))
        case 3:
            tree = {"scene": str(scene), "roi": [f"{name}=-1,-1,-1,1,1,1"], "only": [name]}
            key = dice.choice(("rois", "images", "masks", "only", "selection"))
            tree[key] = [name] if key == "only" else name
            line = ["claim", str(home / "list.json"), "--run-dir", out]
        case 4:
            tree = {"names": [name, *inputs.NAMES[:2]], "candidates": [name]}
            line = ["claim", str(scene), "--rois", rois, "--only", "thing", "--run-dir", out]
            line += ["--selection", str(home / "given")]
            write(home / "given" / "thing.json", json_bytes(dice, tree))
        case _:
            tree = inputs.camera_path()
            tree["cameras"][0]["name"] = name
            line = ["render", ply, "--path", str(home / "list.json"), "--out", out, *CPU]
    write(home / "list.json", json.dumps(tree).encode("utf-8", "surrogatepass"))
    return Case(line)


def named(dice: random.Random, folder: Path) -> Case:
    """A hostile name in one of the formats."""
    kinds = (photos, levels, made_masks, packed, lists) if exchange.INSTALLED else (photos, lists)
    return dice.choice(kinds)(dice, folder)


# Folders of the user's

KEPT = b"a file of the user's"
PICTURE = f"cache/undistorted/{'0a' * 16}.png"
LIKE_OURS = (
    *(PICTURE, f"cache/masks/{'1b' * 16}.png", "stages/scene-0a1b2c3d/model.ply", "preview.ply"),
    *("stages/scene-0a1b2c3d/checkpoint.bin", "result.ply", "levels/1/result.ply", "crops/a.png"),
    *("earlier/0a1b2c3d/result.ply", "archive/result.ply", "events.jsonl", "selection/thing.json"),
)
"""Files that are called as the engine's."""
IN_A_RUN = ("notes.txt", "cache/undistorted/holiday.png", "stages/mine/model.ply", "rois/a.blend",
            "stages/scene-0a1b2c3d/mine.txt", "archive/a.ply", "cache/mine/0.png", "crops/mine.psd",
            "levels/mine.txt", "earlier/mine/a.txt", "earlier/mine.txt")  # fmt: skip
"""Files of the user's in a run folder."""
MANIFESTS = ({"name": "an app of the user's"}, {"icons": []}, [], {}, None, "config", {"Config": 1})


def cleaned(dice: random.Random, folder: Path) -> Case:
    """`clean`, and a training, in run folders with the user's files and in what is none."""
    out = folder / "out"
    if dice.random() < 0.5:  # none, though its files are called so
        keeps = list(LIKE_OURS)
        write(out / "manifest.json", json_bytes(dice, dice.choice(MANIFESTS)))
        keeps.append("manifest.json")
    else:
        keeps = list(IN_A_RUN)
        for name, data in run_files().items():
            write(out / name, data)
        if dice.random() < 0.5:
            listed = {"scene": dice.choice((*HOSTILE, *ODD_VALUES)), "x": "mine"}
            write(out / "stages.json", json_bytes(dice, odd_tree(dice, listed)))
    for name in keeps:
        if name != "manifest.json":
            write(out / name, KEPT)
    if dice.random() < 0.3:  # a folder of ours is a link to one of the user's
        linked = out / dice.choice(("cache/undistorted", "cache/masks", "stages/scene-99999999"))
        write(folder / "in" / "linked" / Path(PICTURE).name, KEPT)
        write(folder / "in" / "linked" / "model.ply", KEPT)
        if not linked.exists():
            linked.parent.mkdir(parents=True, exist_ok=True)
            linked.symlink_to(folder / "in" / "linked")
    line = ["clean", str(out)]
    if dice.random() < 0.3:
        run = ["--rois", good_boxes(folder), "--run-dir", str(out), "--update", *QUICK]
        line = ["train", str(good_scene(folder)), *run]
    return Case(line, keeps=tuple(f"out/{name}" for name in keeps))


COPY = "0a1b2c3d4e5f60718293"
IN_A_CACHE = (
    *("scenes/vase/a.jpg", "scenes/a.jpg", "runs/museum/hall/a.ply", "batches/old/a", "files/x"),
    *(f"scenes/{COPY}/a.jpg", f"runs/{COPY}/hall/a.ply", f"batches/{COPY}/report.html"),
    *(".roigs-removed/mine/a.jpg", ".roigs-removed/a.jpg", "index.json", "copy.lock"),
)
"""Files of the user's in the folder that is named for copies."""


def caches(dice: random.Random, folder: Path) -> Case:
    """A folder of the user's as that of copies, which is full; and copies that others changed."""
    case = on_store(folder, "batch", folder / "out" / "runs", (0, 0, "", ""))
    home, keeps, old = folder / "out" / "copies", list(IN_A_CACHE), time.time() - 7200
    for name in keeps:
        write(home / name, KEPT)
    if dice.random() < 0.5:  # a copy of the scene, with an index of any content
        from roigs_engine.storage.urls import folder_of
        from tests.fuzz.stores import a_machine

        with a_machine(home):
            copied = folder_of((folder / "in").as_uri(), "scenes")
        names = {hostile(dice, folder): [1, "x"] for _ in range(4)}
        index: Any = odd_tree(dice, names) if dice.random() < 0.3 else copy.deepcopy(names)
        text = json.dumps(index).encode("utf-8", "surrogatepass")
        write(copied / "index.json", text)
        write(copied / ".roigs-copy", b"")
        if dice.random() < 0.4:
            write(folder / "in" / "linked" / "0.png", KEPT)
            (copied / "files").mkdir()
            for name in ("images", "sparse"):
                (copied / "files" / name).symlink_to(folder / "in" / "linked")
    for path in [*home.rglob("*/"), *home.rglob("*")]:
        if not path.is_symlink():
            os.utime(path, (old, old))
    plan = json.loads(Path(case[1]).read_bytes()) | {"gigabytes": dice.choice(("0", "1e-9", "50"))}
    write(Path(case[1]), json.dumps(plan))
    case.keeps = tuple(f"out/copies/{name}" for name in keeps)
    return case


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "names": (named, 400),
    "clean": (cleaned, 120),
    "caches": (caches, 80),
}
