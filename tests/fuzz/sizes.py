"""Families: text that repeats itself for long, and files of which the disk has next to nothing."""

from __future__ import annotations

import json
import os
import random
from pathlib import Path

from tests.fuzz import inputs
from tests.fuzz.cases import MODEL, QUICK, Case, Family, good_boxes, good_photos, good_scene, write

LETTERS = 300_000
PARTS = (
    *(
        "//a:",
        "http://a",
        "://",
        "//::::",
        "?",
        "://a",
        "[",
        "]",
        "a@",
        " ",
        '"',
        "'",
        ".",
        "a.",
        "#",
    ),
    *(
        "\u0301\u0316",
        "\u0301",
        "\u0316\u0301",
        "/",
        "../",
        "\\",
        "-",
        "=",
        "a=",
        "\t",
        "(",
        "$",
        "_x",
    ),
)
"""What searches and comparisons may take the square of."""
HOLE = 3 << 30  # bytes: more than a case may take


def repeats(dice: random.Random, folder: Path) -> Case:
    """A value, a name or a comment that is one part again and again."""
    part = dice.choice(PARTS)
    text = (
        dice.choice(("", "a", "x: ")) + part * (LETTERS // len(part)) + dice.choice(("", "x", "\n"))
    )
    scene, boxes = good_scene(folder), good_boxes(folder)
    file = folder / "in" / "given.json"
    match dice.randrange(9):
        case 0:  # any option of an options file
            key = dice.choice(("method", "images", "only", "count", "roi", "masks", "exclude"))
            write(file, json.dumps({"scene": str(scene), "rois": boxes, key: text}))
            return Case(["select", str(file)])
        case 1:
            toml = f"[scenes.hall]\nscene = 'in'\nroi = ['auto']\nmade_for = '''\n{text}\n'''\n"
            table = write(folder / "in" / "table.toml", toml)
            return Case(["batch", str(table), "--run-dir", str(folder / "out"), "--dry-run"])
        case 2:  # the name of a photo
            tree = json.loads(json.dumps(MODEL))
            tree["images"][dice.randrange(2)][3] = text.replace("\n", "x")
            for name, data in inputs.binary_files(tree).items():
                write(scene / "sparse" / "0" / name, data)
            return Case(["inspect", str(scene), "--rois", boxes])
        case 3:
            box = {"name": text, "min": [-1, -1, -1], "max": [1, 1, 1]}
            write(file, json.dumps({"rois": [box]}))
            return Case(["inspect", str(scene), "--rois", str(file)])
        case 4:
            camera = inputs.camera_path()["cameras"][0] | {"name": text}
            write(file, json.dumps({"cameras": [camera]}))
            ply = write(folder / "in" / "a.ply", inputs.good_ply())
            return Case(["render", str(ply), "--path", str(file), "--out", str(folder / "out")])
        case 5 | 6 | 7:  # comments of a PLY
            said = dice.choice(("up axis", "made_for", "SplatRenderMode:", "antialiased", "x"))
            text = dice.choice((text, f"X{' ' * LETTERS}Y"))
            line = f"\ncomment {said} {text}\nelement".encode("utf-8", "replace")
            ply = inputs.good_ply().replace(b"\nelement", line, 1)
            return Case(
                [
                    "convert",
                    str(write(folder / "in" / "a.ply", ply)),
                    str(folder / "out" / "a.splat"),
                ]
            )
        case _:
            write(file, json.dumps({"scribbles": [{"box": "thing", "photo": text, "strokes": []}]}))
            words = ["masks", str(scene), "--rois", boxes, "--scribbles", str(file)]
            return Case([*words, "--out", str(folder / "out" / "masks")])


def holes(dice: random.Random, folder: Path) -> Case:
    """A good file with a hole of gigabytes behind its end, or nothing else."""
    scene, boxes = good_scene(folder), good_boxes(folder)
    ply, path = folder / "in" / "a.ply", folder / "in" / "path.json"
    write(ply, inputs.good_ply())
    write(path, json.dumps(inputs.camera_path()))
    names = [f"sparse/0/{name}" for name in inputs.binary_files(MODEL)]
    names += [f"images/{name}" for name in good_photos()]
    commands = {
        ply: ["convert", str(ply), str(folder / "out" / "b.splat")],
        path: ["render", str(ply), "--path", str(path), "--out", str(folder / "out")],
        **{scene / name: ["claim", str(scene), "--rois", boxes, *QUICK] for name in names},
        Path(boxes): ["inspect", str(scene), "--rois", boxes],
    }
    file = dice.choice(list(commands))
    if dice.random() < 0.3:
        file.write_bytes(b"")
    os.truncate(file, HOLE)
    command = commands[file]
    return Case([*command, "--run-dir", str(folder / "out")] if command[0] == "claim" else command)


FAMILIES: dict[str, tuple[Family, int]] = {"repeats": (repeats, 200), "holes": (holes, 60)}
