"""Damaged files that commands are given: Gaussians, boxes, requests, photo lists, paths, splits."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

from tests.fuzz import inputs
from tests.fuzz.cases import Command, Family, good_boxes, good_scene, json_bytes, odd_tree, write
from tests.fuzz.damage import (
    ODD_FLOATS,
    ODD_TEXTS,
    bytes_damaged,
    tree_damaged,
)


def gaussians(dice: random.Random, folder: Path) -> Command:
    """PLYs with damaged headers, other properties and formats, and values out of any range."""
    bands = dice.choice((1, 4, 9, 16))
    names, table = inputs.ply_names(bands), inputs.ply_table(bands)
    properties: list[list[Any]] = [["float", name] for name in names]
    count: Any = len(table)
    elements: list[list[Any]] = [["vertex", count, properties]]
    form = "binary_little_endian"
    kind = dice.randrange(10)
    if kind == 0:
        form = dice.choice(("ascii", "binary_big_endian", "binary_middle_endian", ""))
    elif kind == 1:
        elements[0][1] = dice.choice(
            (0, 1, 29, 31, 1 << 31, 1 << 63, -1, "9" * 5000, "x", "²", "1e3", "")
        )
    elif kind == 2:
        elements = tree_damaged(dice, elements, same_type=True)
    elif kind == 3:
        dice.shuffle(properties)
    elif kind == 4:
        for _ in range(dice.randint(1, 9)):
            properties.insert(
                dice.randrange(len(properties) + 1),
                [
                    dice.choice(("double", "uchar", "list uchar int", "half")),
                    f"extra_{dice.random()}",
                ],
            )
    elif kind == 5:
        packed = [["uint", f"packed_{n}"] for n in ("position", "rotation", "scale", "color")]
        elements = [["chunk", 1, [["float", "min_x"]]], ["vertex", count, packed]]
        if dice.random() < 0.5:
            elements.reverse()
    elif kind == 6:
        for _ in range(dice.randint(1, 20)):
            with_odd = dice.choice((*ODD_FLOATS, 30.0, 88.0, -100.0, 1e6))
            table[dice.randrange(count), dice.randrange(len(names))] = with_odd
    elif kind == 7:
        table[:, dice.randrange(len(names))] = dice.choice((*ODD_FLOATS, 5.0, 30.0))
    try:
        data = inputs.ply(form, elements, table)
    except (ValueError, TypeError, IndexError, AttributeError):
        data = b"ply\n"
    if kind >= 8:
        head = data.index(b"end_header")
        data = (
            bytes_damaged(dice, data[:head]) + data[head:]
            if kind == 8
            else bytes_damaged(dice, data)
        )
    path = str(write(folder / "in" / "a.ply", data))
    other = str(write(folder / "in" / "b.ply", inputs.good_ply()))
    cameras = str(write(folder / "in" / "path.json", json.dumps(inputs.camera_path())))
    rois = good_boxes(folder)
    out = folder / "out"
    pair = [path, other] if dice.random() < 0.5 else [other, path]
    return dice.choice(
        (
            ["splats", path],
            ["render", path, "--path", cameras, "--out", str(out), "--threads", "1"],
            [
                "compose",
                pair[0],
                "--rois",
                rois,
                "--object",
                f"thing={pair[1]}",
                "--out",
                str(out / "c.ply"),
            ],
        )
    )


def rois(dice: random.Random, folder: Path) -> Command:
    """`rois.json` of every wrong shape."""
    scene = good_scene(folder)
    tree = odd_tree(dice, inputs.ROIS)
    if dice.random() < 0.3 and isinstance(tree, dict) and isinstance(tree.get("rois"), list):
        for box in tree["rois"]:
            if isinstance(box, dict):
                box["name"] = dice.choice(ODD_TEXTS)
    path = str(write(folder / "in" / "rois.json", json_bytes(dice, tree)))
    out = str(folder / "out")
    return dice.choice(
        (
            ["inspect", str(scene), "--rois", path],
            ["select", str(scene), "--rois", path, "--out", out],
            ["claim", str(scene), "--rois", path, "--run-dir", out],
        )
    )


def requests(dice: random.Random, folder: Path) -> Command:
    """Request files of every wrong shape."""
    scene = good_scene(folder)
    boxes = good_boxes(folder)
    command = dice.choice(("inspect", "select", "claim", "claim", "export"))
    tree: dict[str, Any] = {
        "scene": str(scene),
        "max_side": 24,
        "threads": 1,
        "images": str(scene / "images"),
    }
    if command != "export":
        tree |= {"rois": boxes, "roi": ["third=-1,-1,-1,1,1,1"], "only": ["thing", "third"]}
    if command in ("select", "claim"):
        tree |= {"method": "greedy", "count": 2, "seed": 1, "test-every": 2}
    if command == "claim":
        tree |= {"preset": "draft", "strategy": "joint", "steps_factor": 0.001, "kept-share": 0.5}
        tree |= {"roi_init": "scene", "roi_order": "ordered", "sh_degree": 1, "update": True}
        tree |= {"preview_seconds": 1.5}
    options = list(tree)
    for key in dice.sample(options[1:], dice.randrange(len(options))):
        del tree[key]
    path = str(write(folder / "in" / "request.json", json_bytes(dice, odd_tree(dice, tree))))
    out = str(folder / "out")
    return [
        command,
        path,
        *(
            ["--run-dir", out]
            if command == "claim"
            else ["--out", out]
            if command != "inspect"
            else []
        ),
    ]


def selections(dice: random.Random, folder: Path) -> Command:
    """Files of `--selection` of every wrong shape."""
    scene = good_scene(folder)
    boxes = good_boxes(folder)
    names = dice.sample(inputs.NAMES, 3)
    tree = {"roi": "thing", "method": "given", "names": names, "scores": [0.1, 0.2, 0.3],
            "candidates": inputs.NAMES, "flags": [], "features": {}}  # fmt: skip
    if dice.random() < 0.5:
        tree = {"names": names}
    given = folder / "in" / "given"
    write(given / dice.choice(("thing.json", "other.json")), json_bytes(dice, odd_tree(dice, tree)))
    return [
        "claim",
        str(scene),
        "--rois",
        boxes,
        "--selection",
        str(given),
        "--run-dir",
        str(folder / "out"),
    ]


def paths(dice: random.Random, folder: Path) -> Command:
    """Camera paths of every wrong shape."""
    model = str(write(folder / "in" / "a.ply", inputs.good_ply()))
    tree = odd_tree(dice, inputs.camera_path())
    if dice.random() < 0.3 and isinstance(tree, dict) and isinstance(tree.get("cameras"), list):
        for camera in tree["cameras"]:
            if isinstance(camera, dict):
                camera["name"] = dice.choice(ODD_TEXTS)
    path = str(write(folder / "in" / "path.json", json_bytes(dice, tree)))
    return ["render", model, "--path", path, "--out", str(folder / "out"), "--threads", "1"]


def splits(dice: random.Random, folder: Path) -> Command:
    """Files of `evaluate --split` of every wrong shape."""
    scene = good_scene(folder)
    boxes = good_boxes(folder)
    model = str(write(folder / "in" / "a.ply", inputs.good_ply()))
    split = str(
        write(
            folder / "in" / "split.json",
            json_bytes(dice, odd_tree(dice, {"evaluate_on": "test", "test": inputs.NAMES[:1]})),
        )
    )
    name = (
        dice.choice(("A", "A", "A", *ODD_TEXTS))
        .replace("\0", "")
        .encode("utf-8", "replace")
        .decode()
    )
    command = ["evaluate", str(scene), "--rois", boxes, "--split", split, "--max-side", "24"]
    return [*command, "--threads", "1", f"--model={name}={model}", "--out", str(folder / "out")]


FAMILIES: dict[str, tuple[Family, int]] = {
    "gaussians": (gaussians, 750),
    "rois": (rois, 450),
    "requests": (requests, 600),
    "selections": (selections, 150),
    "paths": (paths, 220),
    "splits": (splits, 50),
}
