"""Families: `levels.json` and what lies beside it, and strokes on photos, damaged in every way."""

from __future__ import annotations

import functools
import json
import random
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tests.fuzz import inputs
from tests.fuzz.cases import Case, good_boxes, good_scene, json_bytes, odd_tree, write
from tests.fuzz.damage import ODD_FLOATS, ODD_TEXTS, ODD_VALUES, bytes_damaged

CPU = ["--device", "cpu", "--threads", "1"]
MAKE = ["--levels", "2", "--steps", "1", *CPU]
FILES = ("levels.json",) * 5 + ("levels/made.json", "manifest.json", "settings.json")
MODELS = ("background.ply", "rois/thing.ply", "levels/1/background.ply", "levels/1/rois/thing.ply",
          "result.ply")  # fmt: skip


@functools.cache
def run_files() -> dict[str, bytes]:
    """A run folder with a level of each part."""
    from roigs_engine.formats.levels import Ladder, Level, write_ladders
    from roigs_engine.model.gaussians import Gaussians

    dice = np.random.default_rng(3)
    with tempfile.TemporaryDirectory(prefix="roigs-fuzz-") as name:
        folder, ladders, parts = Path(name), [], []
        for box, ply in (("", "background.ply"), ("thing", "rois/thing.ply")):
            places = dice.uniform(-0.45, 0.45, (128, 3))
            whole = Gaussians.from_points(places, dice.integers(0, 256, (128, 3)).astype(np.uint8))
            whole.save_ply(folder / ply)
            whole.rows(torch.arange(64)).save_ply(folder / "levels/1" / ply)
            parts.append(whole)
            levels = [
                Level(ply=path, gaussians=count, farther=farther, measured={"psnr": 30.0})
                for path, count, farther in ((ply, 128, 0.0), (f"levels/1/{ply}", 64, 1.5))
            ]
            ladders.append(Ladder(box=box, rate=20.0, probes=places[:4], levels=tuple(levels)))
        Gaussians.concatenate(parts).save_ply(folder / "result.ply")
        write_ladders(folder, ladders)
        made = {f"levels/1/{ply}": "0" * 64 for ply in ("background.ply", "rois/thing.ply")}
        write(folder / "levels/made.json", json.dumps(made))
        record = {"version": 3, "sizes": ["48x36"], "photos": inputs.PHOTOS}
        write(folder / "manifest.json", json.dumps(record))
        found = sorted(path for path in folder.rglob("*") if path.is_file())
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def levels(dice: random.Random, folder: Path) -> Case:
    """A run with levels whose files are damaged: drawn, or made again."""
    scene, out = good_scene(folder), folder / "out"
    files = dict(run_files())
    files["settings.json"] = json.dumps({"scene": str(scene)}).encode()
    for name in dice.sample(FILES, dice.choice((1, 1, 2))):
        tree = json.loads(run_files().get(name, files[name]))
        if name == "levels.json" and dice.random() < 0.6:
            tree = odd_ladders(dice, tree)
            files[name] = json.dumps(tree).encode("utf-8", "surrogatepass")
        elif name == "settings.json" and dice.random() < 0.5:
            tree[dice.choice(("scene", "images"))] = dice.choice(ODD_VALUES)
            files[name] = json_bytes(dice, tree)
        else:
            files[name] = json_bytes(dice, odd_tree(dice, tree))
    if dice.random() < 0.3:
        name = dice.choice(MODELS)
        files[name] = dice.choice((b"", odd_model(dice), bytes_damaged(dice, files[name])))
    for name, data in files.items():
        write(out / name, data)
    if dice.random() < 0.1:
        put_something(dice, out / dice.choice((*FILES, *MODELS, "levels", "levels/1", "rois")))
    if dice.random() < 0.5:
        more = dice.choice(([], [], ["--scene", str(scene)]))
        return Case(["levels", str(out), *MAKE, *more], statuses=(0, 2))
    cameras = str(write(folder / "in" / "path.json", json.dumps(inputs.camera_path())))
    line = ["render", str(out / "result.ply"), "--path", cameras, "--levels", *CPU]
    quality = dice.choice(("0.01", "1", "1", "100"))
    return Case([*line, "--quality", quality, "--out", str(out / "pictures")])


def odd_ladders(dice: random.Random, tree: Any) -> Any:
    """`levels.json` with one or two of its own values out of place."""
    for _ in range(dice.choice((1, 2))):
        part = dice.choice(tree["parts"])
        home = dice.choice((part, dice.choice(part["levels"] or [{}])))
        key = dice.choice(list(home) or ["ply"])
        numbers = (*ODD_FLOATS, 1e30, 1e150, -1e150, 1e-30, 1e-150, 3, 1.6, 1.5)
        match key:
            case "probes":
                part[key] = [[dice.choice(numbers) for _ in range(3)] for _ in range(3)]
            case "ply":
                others = ("", ".", "rois", "levels.json", "result.ply", "levels/1/background.ply")
                home[key] = dice.choice((*others, *ODD_TEXTS))
            case "rate" | "farther" | "gaussians":
                home[key] = dice.choice((*numbers, 10**400, True, "1", None))
            case "levels":
                part[key] = dice.choice((part[key][::-1], part[key] * 3, [], [{}], part[key][1:]))
            case _:
                home[key] = dice.choice(ODD_VALUES)
    if dice.random() < 0.1:
        tree["parts"] = dice.choice(([], tree["parts"] * 2, tree["parts"][:1], {}))
    return tree


def odd_model(dice: random.Random) -> bytes:
    """A whole PLY with few Gaussians, other colours, or numbers at the end of their range."""
    bands, count = dice.choice((1, 4, 9, 16)), dice.choice((0, 1, 2, 30, 200))
    names, table = inputs.ply_names(bands), inputs.ply_table(bands, count)
    if dice.random() < 0.6:
        column = names.index(dice.choice(("opacity", "scale_0", "x", "rot_0", "f_dc_0")))
        table[:, column] = dice.choice((-1e4, 1e4, 0.0, 80.0, -80.0, 1e30, float("nan")))
    properties = [["float", name] for name in names]
    return inputs.ply("binary_little_endian", [["vertex", count, properties]], table)


def put_something(dice: random.Random, path: Path) -> None:
    """A folder, a link or a file in the place of a file or folder."""
    if path.exists():
        path.rename(path.parents[len(path.parts) - path.parts.index("out") - 1] / "in" / "moved")
    path.parent.mkdir(parents=True, exist_ok=True)
    match dice.randrange(4):
        case 0:
            path.mkdir()
        case 1:
            path.symlink_to(path)
        case 2:
            path.symlink_to("/dev/null")
        case _:
            path.write_bytes(b"x")


def scribbles(dice: random.Random, folder: Path) -> Case:
    """Strokes of every wrong shape, beside masks and a record that may be damaged."""
    scene, rois, out = good_scene(folder), good_boxes(folder), folder / "out"
    photos = dice.sample(inputs.NAMES, dice.choice((1, 1, 2)))
    tree: Any = {"scribbles": [scribble(dice, photo) for photo in photos]}
    data = json.dumps(tree).encode()
    if dice.random() < 0.5:
        data = json_bytes(dice, odd_tree(dice, tree))
    path = str(write(folder / "in" / "strokes.json", data))
    if dice.random() < 0.4:
        record = {"masks": {f"{name}.png": "0" * 64 for name in inputs.NAMES}}
        write(out / "thing" / "made.json", json_bytes(dice, odd_tree(dice, record)))
    if dice.random() < 0.4:
        from tests.fuzz.masks import mask

        write(out / "thing" / f"{dice.choice(inputs.NAMES)}.png", mask(dice))
    line = ["masks", str(scene), "--rois", rois, "--scribbles", path, "--out", str(out), *CPU]
    if dice.random() < 0.5:
        model = odd_model(dice) if dice.random() < 0.4 else run_files()["result.ply"]
        line += ["--model", str(write(folder / "in" / "a.ply", model))]
    if dice.random() < 0.2:
        line += ["--photo", dice.choice((*inputs.NAMES, "x", "é", "../0.png"))]
    return Case(line)


def scribble(dice: random.Random, photo: str) -> dict[str, Any]:
    """Strokes that a person might have drawn, or not."""
    far = dice.choice((1, 1, 1, 1, 0.1, 10, 1e4, 9e5))
    x, y = inputs.WIDTH / 2, inputs.HEIGHT / 2

    def places(radius: float, count: int) -> list[list[float]]:
        angles = [6.3 * k / max(count - 1, 1) for k in range(count)]
        turned = [[float(np.cos(a)), float(np.sin(a))] for a in angles]
        return [[x + far * radius * c, y + far * radius * s] for c, s in turned]

    kinds = dice.choice((["object", "background"],) * 5 + (["object"], ["background"]))
    strokes = [
        {
            "kind": kind,
            "width": dice.choice((2, 2, 2, 0.1, 1e-300, 40, 3e4, 9e5)),
            "points": places(3 if kind == "object" else 9, dice.choice((1, 2, 5, 9, 300))),
        }
        for kind in kinds
    ]
    return {"box": dice.choice(("thing", "thing", "other")), "photo": photo, "strokes": strokes}


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "levels": (levels, 300),
    "scribbles": (scribbles, 300),
}
