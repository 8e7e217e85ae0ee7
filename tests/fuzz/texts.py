"""More families: texts that mislead (a key twice, control characters), and places to write to.

Each case says how it may end: see `Case`.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fuzz import inputs
from tests.fuzz.cases import QUICK, Case, good_boxes, good_photos, good_scene, write, write_scene
from tests.fuzz.user_input import good_line

SMALL = ("--device", "cpu", "--max-side", "24")
CONTROLS = ("\x1b[2J", "\x1b]0;title\x07", "\n", "\nerror: all is lost.", "\r", "\x7f", "\x9b1m",
            "\x85", "\u2028", "\u202e", "\t", "\x08")  # fmt: skip


# Keys


def twice(dice: random.Random, folder: Path) -> Case:
    """A JSON file that a person writes, one object of which has a key twice: it is named."""
    scene, rois, out = good_scene(folder), good_boxes(folder), str(folder / "out")
    ply = str(write(folder / "in" / "a.ply", inputs.good_ply()))
    kind = dice.choice(("rois", "options", "selection", "path", "split"))
    name = f"{kind}.json"
    path = str(folder / "in" / name)
    match kind:
        case "rois":
            tree: Any = inputs.ROIS
            command = dice.choice(("inspect", "select"))
            line = [command, str(scene), "--rois", path]
        case "options":
            tree = {"scene": str(scene), "rois": rois, "max_side": 24, "only": ["thing"]}
            line = ["select", path, "--out", out]
        case "selection":
            name, tree = (
                "given/thing.json",
                {"names": inputs.NAMES[:3], "features": {"a": {"b": 1}}},
            )
            line = ["train", str(scene), "--rois", rois, "--only", "thing", "--run-dir", out]
            line += ["--selection", str(folder / "in" / "given"), *QUICK]
        case "path":
            tree = inputs.camera_path()
            line = ["render", ply, "--path", path, "--out", out, "--device", "cpu"]
        case _:
            tree = {"test": inputs.NAMES[:1]}
            line = ["evaluate", str(scene), "--rois", rois, "--split", path, "--model", f"A={ply}"]
            line += ["--out", out, *SMALL]
    well = dice.random() < 0.2
    write(folder / "in" / name, json.dumps(tree) if well else doubled(dice, tree))
    if well:
        return Case(line, statuses=(0,))
    return Case(line, statuses=(2,), names=(Path(name).name,))


def doubled(dice: random.Random, tree: Any) -> str:
    """The tree as JSON, with one key of one object there twice."""
    objects = [node for node in nodes(tree) if isinstance(node, dict) and node]
    chosen = dice.choice(objects)
    key = dice.choice(list(chosen))
    other = dice.choice((chosen[key], None, 1, []))

    def text(node: Any) -> str:
        if isinstance(node, dict):
            pairs = [f"{json.dumps(k)}: {text(v)}" for k, v in node.items()]
            if node is chosen:
                spelled = json.dumps(key) if dice.random() < 0.7 else escaped(key)
                pairs.insert(dice.randrange(len(pairs) + 1), f"{spelled}: {json.dumps(other)}")
            return "{" + ", ".join(pairs) + "}"
        if isinstance(node, list):
            return "[" + ", ".join(map(text, node)) + "]"
        return json.dumps(node)

    return text(tree)


def escaped(key: str) -> str:
    """The same key as JSON, in other characters."""
    return '"' + "".join(f"\\u{ord(letter):04x}" for letter in key) + '"'


def nodes(tree: Any) -> list[Any]:
    """The tree and everything below it."""
    below = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ()
    return [tree, *(node for child in below for node in nodes(child))]


# Control characters


def controls(dice: random.Random, folder: Path) -> Case:
    """Control characters in every text that may be shown; the worker looks at what is shown."""

    def odd(text: str) -> str:
        at = dice.randrange(len(text) + 1)
        return text[:at] + dice.choice(CONTROLS) + text[at:]

    tree, photos = inputs.model(), dict(good_photos())
    for image in tree["images"]:
        if dice.random() < 0.7:
            name = image[3]
            image[3] = odd(name)
            photos[image[3]] = photos.pop(name) if dice.random() < 0.6 else b""
    write_scene(folder / "in", inputs.binary_files(tree), photos)
    scene, rois, out = str(folder / "in"), good_boxes(folder), str(folder / "out")
    ply = str(write(folder / "in" / "a.ply", inputs.good_ply()))
    line = dice.choice(
        (
            ["inspect", scene, "--rois", rois],
            ["inspect", scene, "--rois", rois, "--check-photos"],
            ["select", scene, "--rois", rois, "--out", out, "--count", "9"],
            ["evaluate", scene, "--rois", rois, f"--model={odd('A')}={ply}", "--out", out, *SMALL],
            ["render", ply, "--scene", scene, "--out", out, *SMALL],
            ["render", ply, "--scene", scene, "--name", odd("a.jpg"), "--out", out],
            ["inspect", scene, "--rois", rois, "--only", odd("thing")],
            ["inspect", odd(scene), "--rois", rois],
            ["select", scene, "--roi", odd("thing=-1,-1,-1,1,1,1")],
            ["claim", scene, "--rois", rois, "--run-dir", out],
            [odd("inspect"), scene],
        )
    )
    if dice.random() < 0.3:
        values = {"scene": scene, odd("rois"): rois, odd("method"): odd("fvs")}
        line = ["select", str(write(folder / "in" / "options.json", json.dumps(values)))]
    return Case(line)


# Places to write to

OWN = ("", "result.ply", "report.md", "crops", "crops/thing", "selection", "stages", "rois",
       "cache", "earlier/x", "compare-joint", "stages/a", "Manifest.json")  # fmt: skip
FREE = ("renders", "evaluation/crops", "other")


def places(dice: random.Random, folder: Path) -> Case:
    """A run folder in the place of `--out`: what is the run's own is refused."""
    run, command = (
        folder / "out",
        dice.choice(("export", "select", "evaluate", "render", "compose")),
    )
    for name in ("manifest.json", "split.json", "report.md", "result.ply"):
        write(run / name, b"{}")
    line = good_line(command, folder)
    free = dice.random() < 0.3
    place = dice.choice(FREE if free else OWN)
    if command == "compose":
        place = place if place.endswith(".ply") else f"{place}/c.ply".lstrip("/")
        free = free or place == "c.ply"
    out = str(run / place) + dice.choice(
        ("", "/", "/.", "/x/..") if command != "compose" else ("",)
    )
    line[line.index("--out") + 1] = out
    return Case(line, statuses=(0,)) if free else Case(line, statuses=(2,), names=(str(run),))


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "twice": (twice, 150),
    "controls": (controls, 200),
    "places": (places, 100),
}
