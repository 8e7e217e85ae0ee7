"""Families: what people give: options, encodings, devices in place of files, scenes of any scale.

Each case says how it may end: see `Case`.
"""

from __future__ import annotations

import argparse
import codecs
import copy
import json
import os
import random
import shutil
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz import inputs
from tests.fuzz.cases import (
    QUICK,
    Case,
    Command,
    good_boxes,
    good_photos,
    good_scene,
    json_bytes,
    write,
    write_scene,
)
from tests.fuzz.damage import ODD_TEXTS, ODD_VALUES

# The command line

NUMBERS = ("-1", "0", "1", "1e303", "-1e303", "nan", "inf", "-inf", "1" + "0" * 20, "9" * 5000,
           "0.5", "1e-320", "", " ", "text", "0x10", "1_0", "²", "٣",
           "1,5", "+3", " 3 ")  # fmt: skip


def good_line(command: str, folder: Path) -> Command:
    """A good command line of any command, quick to run."""
    scene, out, rois = str(good_scene(folder)), str(folder / "out"), good_boxes(folder)
    ply = str(write(folder / "in" / "a.ply", inputs.good_ply()))
    path = str(write(folder / "in" / "path.json", json.dumps(inputs.camera_path())))
    match command:
        case "inspect":
            return [command, scene, "--rois", rois]
        case "export":
            return [command, scene, "--out", out]
        case "select":
            return [command, scene, "--rois", rois, "--out", out]
        case "compose":
            line = [command, ply, "--rois", rois, "--object", f"thing={ply}"]
            return [*line, "--out", f"{out}/c.ply"]
        case "evaluate":
            line = [command, scene, "--rois", rois, "--model", f"A={ply}", "--device", "cpu"]
            return [*line, "--out", out]
        case "render":
            return [command, ply, "--path", path, "--out", out, "--device", "cpu"]
        case _:
            return [command, scene, "--rois", rois, "--run-dir", out]


def options(dice: random.Random, folder: Path) -> Case:
    """Every option of every command with numbers, texts and paths that do not fit, and with some
    that do; on the command line or in an options file."""
    from roigs_engine.commands.parser import build_parser
    from roigs_engine.requests.values import Name, Number

    command = dice.choice(
        ("inspect", "export", "select", "compose", "evaluate", "render", "claim", "claim", "run")
    )
    line = good_line(command, folder)
    parser = build_parser()[1][command]
    chosen = dice.choice([a for a in parser._actions if a.dest not in ("help", "events")])
    if isinstance(chosen.type, Number):
        value = dice.choice((*NUMBERS, str(chosen.type.low), str(chosen.type.high)))
    elif isinstance(chosen.type, Name) and chosen.type.__class__ is not Name:
        value = dice.choice((*ODD_TEXTS, "", " ", str(folder / "in"), "/dev/null", "in", "~"))
    else:
        value = dice.choice((*ODD_TEXTS, *NUMBERS, "thing", "thing=1,2,3,4,5,6", "thing=nan" * 6))
    text = value.replace("\0", "").encode("utf-8", "replace").decode()
    if command == "run" and "--dry-run" not in line:
        line += ["--dry-run", "--steps-factor", "0.003"]
        if chosen.dest in ("dry_run", "steps_factor"):
            chosen = next(a for a in parser._actions if a.dest == "seed")
    given = option_words(chosen, text)
    if text.startswith("/dev/") and chosen.dest in ("out", "run_dir"):
        given = []
    if not chosen.option_strings:
        line[1] = text if not text.startswith("-") else f"./{text}"
    elif command in ("select", "claim") and given and dice.random() < 0.3:
        return in_options_file(dice, folder, command, chosen)
    elif given and given[0].partition("=")[0] in line and dice.random() < 0.7:
        at = line.index(given[0].partition("=")[0])  # in the place of the good value
        line[at : at + 2] = given
    else:
        line += given
    if dice.random() < 0.1:
        line += given
    line = [os.path.join(folder, word) if word == "in" else word for word in line]
    case = Case(in_case(line, folder))
    if given and given[0] in case and not taken(chosen, text):
        case.statuses, case.names = (2,), (given[0].partition("=")[0],)
    return case


def taken(option: argparse.Action, text: str) -> bool:
    """Whether an option takes a text, as far as that can be seen without files."""
    if option.nargs == 0 or option.choices is not None:
        return option.nargs == 0 or text in option.choices
    try:
        return callable(option.type) and option.type(text) is not None
    except argparse.ArgumentTypeError:
        return False


def in_case(line: Command, folder: Path) -> Command:
    """The line with its output inside the case, whatever path it was given."""
    for flag in ("--out", "--run-dir"):
        for k, word in enumerate(line):
            name, mark, value = word.partition("=")
            if name == flag and mark and value.strip():
                line[k] = f"{flag}={folder}/out/{value.replace('..', '').strip('/')[:300]}"
    return line


def option_words(option: argparse.Action, text: str) -> list[str]:
    """The option with that value, as words of a command line."""
    if not option.option_strings:
        return []
    flag = option.option_strings[0]
    return [flag] if option.nargs == 0 else [f"{flag}={text}"]


def in_options_file(
    dice: random.Random, folder: Path, command: str, option: argparse.Action
) -> Case:
    """A value of any type in an options file."""
    scene, out = str(folder / "in"), str(folder / "out")
    tree = {"scene": scene, "rois": good_boxes(folder)}
    tree[option.dest] = copy.deepcopy(dice.choice((*ODD_VALUES, *NUMBERS)))
    if option.dest in ("out", "run_dir"):
        del tree[option.dest]
    path = str(write(folder / "in" / "options.json", json_bytes(dice, tree)))
    place = "--run-dir" if command == "claim" else "--out"
    return Case([command, path, place, out])


ENCODINGS: dict[str, Callable[[str], bytes]] = {
    "plain": lambda text: text.encode(),
    "mark": lambda text: codecs.BOM_UTF8 + text.encode(),
    "mark, lines of Windows": lambda text: codecs.BOM_UTF8 + text.replace("\n", "\r\n").encode(),
    "utf-16": lambda text: text.encode("utf-16"),
    "utf-16-le": lambda text: text.encode("utf-16-le"),
    "utf-16-be": lambda text: text.encode("utf-16-be"),
    "utf-32": lambda text: text.encode("utf-32"),
    "latin-1": lambda text: text.encode("latin-1", "replace"),
    "two marks": lambda text: codecs.BOM_UTF8 * 2 + text.encode(),
    "empty": lambda text: b"",
    "mark only": lambda text: codecs.BOM_UTF8,
    "half": lambda text: text.encode()[: len(text) // 2],
}
WELL = ("plain", "mark", "mark, lines of Windows")


def bom(dice: random.Random, folder: Path) -> Case:
    """Every text file in every encoding: with a mark it is read; else one line names the file."""
    coding = dice.choice(list(ENCODINGS))
    kind = dice.choice(("rois", "options", "selection", "path", "split", "model"))
    encode, scene, out = ENCODINGS[coding], good_scene(folder), str(folder / "out")
    umlauts = {"note": "größe"}  # ignored, and not ASCII
    given, rois, name = folder / "in" / "given", good_boxes(folder), f"{kind}.json"
    ply = str(write(folder / "in" / "a.ply", inputs.good_ply()))
    match kind:
        case "rois":
            tree: Any = {**inputs.ROIS, **umlauts}
            line = ["inspect", str(scene), "--rois", str(folder / "in" / name)]
        case "options":
            boxes_text = ["größe=-1,-1,-1,1,1,1", "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"]
            tree = {"scene": str(scene), "roi": boxes_text, "only": ["thing"]}
            line = ["select", str(folder / "in" / name), "--out", out]
        case "selection":
            tree, given, name = {"names": inputs.NAMES[:3], **umlauts}, given, "given/thing.json"
            line = ["claim", str(scene), "--rois", rois, "--only", "thing"]
            line += ["--selection", str(given), "--run-dir", out, "--test-every", "4"]
        case "path":
            tree = {**inputs.camera_path(), **umlauts}
            line = ["render", ply, "--path", str(folder / "in" / name), "--out", out]
            line += ["--device", "cpu", "--threads", "1"]
        case "split":
            tree = {"test": inputs.NAMES[:1], **umlauts}
            line = ["evaluate", str(scene), "--rois", rois, "--split", str(folder / "in" / name)]
            line += ["--model", f"A={ply}", "--out", out, "--max-side", "24", "--device", "cpu"]
        case _:
            return text_model(dice, folder, coding)
    indent = dice.choice((None, 1))
    write(folder / "in" / name, encode(json.dumps(tree, ensure_ascii=False, indent=indent)))
    if coding in WELL:
        return Case(line, statuses=(0,))
    return Case(line, statuses=(2,), names=(Path(name).name,))


def text_model(dice: random.Random, folder: Path, coding: str) -> Case:
    """A text model with one file in that encoding."""
    files = inputs.text_files(inputs.model())
    name = dice.choice(("cameras.txt", "images.txt", "points3D.txt"))
    files[name] = ENCODINGS[coding](files[name].decode())
    scene = folder / "in" / "text"
    write_scene(scene, files, good_photos())
    case = Case(["inspect", str(scene)])
    wide = coding.startswith("utf-")
    if coding in WELL:
        case.statuses = (0,)
    elif wide:
        case.statuses, case.names = (2,), (name,)
    return case


# Devices

PLACES = ("rois", "options", "path", "split", "selection", "scene", "cameras.bin", "images.bin",
          "points3D.bin", "ply", "out", "images")  # fmt: skip
KINDS = (
    "folder",
    "loop",
    "dangling",
    "zero",
    "null",
    "full",
    "fifo",
    "no rights",
    "socket",
    "file",
)


def put_device(kind: str, path: Path) -> None:
    """Put something else in the place of an input."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    match kind:
        case "folder":
            path.mkdir()
        case "loop":
            path.symlink_to(path)
        case "dangling":
            path.symlink_to(path.with_name("nothing here"))
        case "zero" | "null" | "full":
            path.symlink_to(f"/dev/{kind}")
        case "fifo":
            os.mkfifo(path)
        case "no rights":
            path.write_bytes(b"{}")
            path.chmod(0)
        case "file":
            path.write_bytes(b"nothing of use")
        case _:
            home = os.open(path.parent, os.O_RDONLY)  # the path is too long for a socket's name
            with socket.socket(socket.AF_UNIX) as server:
                server.bind(f"/proc/self/fd/{home}/{path.name}")
            os.close(home)


def devices(dice: random.Random, folder: Path) -> Case:
    """A device, pipe, link or folder in the place of each input and output."""
    place, kind = dice.choice(PLACES), dice.choice(KINDS)
    home = folder / "in"
    line = good_line(dice.choice(("inspect", "export", "select", "claim")), folder)
    path = {
        "scene": home,
        "images": home / "images",
        "out": folder / "out",
        "rois": home / "rois.json",
        "options": home / "options.json",
        "path": home / "path.json",
        "split": home / "split.json",
        "selection": home / "given" / "thing.json",
        "ply": home / "a.ply",
    }.get(place, home / "sparse" / "0" / place)
    out = str(folder / "out")
    match place:
        case "rois":
            line = good_line(dice.choice(("inspect", "select", "claim")), folder)
        case "options":
            line = ["select", str(path), "--out", out]
        case "path":
            line = good_line("render", folder)
        case "split":
            line = [*good_line("evaluate", folder), "--split", str(path)]
        case "selection":
            path.parent.mkdir()
            line = [*good_line("claim", folder), "--selection", str(path.parent)]
        case "ply":
            line = good_line(dice.choice(("render", "compose", "evaluate")), folder)
        case "out":
            line = good_line(dice.choice(("export", "select", "claim", "render")), folder)
    put_device(kind, path)
    return Case(line)


# Scales


def scales(dice: random.Random, folder: Path) -> Case:
    """Models of any size and place, and with a stray camera; the boxes go with them."""
    factor = 10.0 ** dice.choice((-6, -5, -4, -3, -1, 0, 1, 3, 4, 5, 6))
    shift = [dice.choice((0.0, 0.0, 1e3, 1e6)) * dice.choice((1, -1)) for _ in range(3)]
    tree = inputs.model()
    for image in tree["images"]:
        pose = np.array(image[1])
        rotation = rotation_of(pose[:4])
        pose[4:] = factor * pose[4:] - rotation @ shift
        image[1] = pose.tolist()
    for point in tree["points3D"]:
        point[1] = (factor * np.array(point[1]) + shift).tolist()
    if dice.random() < 0.4:
        stray = dice.choice(tree["images"])
        stray[1][4:] = [dice.choice((1e3, 1e6, 1e9, -1e12)) * factor for _ in range(3)]
    low, high = (np.array([side] * 3) * 0.5 * factor + shift for side in (-1, 1))
    box = {"name": "thing", "min": low.tolist(), "max": high.tolist()}
    write_scene(folder / "in", inputs.binary_files(tree), good_photos())
    rois = str(write(folder / "in" / "rois.json", json.dumps([box])))
    scene, out = str(folder / "in"), str(folder / "out")
    line = dice.choice(
        (
            ["inspect", scene, "--rois", rois],
            ["select", scene, "--rois", rois, "--out", out, "--method"],
            ["claim", scene, "--rois", rois, "--run-dir", out],
            ["train", scene, "--rois", rois, "--run-dir", out, *QUICK],
        )
    )
    if line[-1] == "--method":
        line.append(dice.choice(("coverage", "static", "greedy", "fvs", "random", "gp6", "gp9")))
    return Case(line)


def rotation_of(quaternion: Any) -> Any:
    """(3, 3) of a quaternion wxyz."""
    from roigs_engine.model.rotations import rotation_entries

    return np.reshape(rotation_entries(*(quaternion / np.linalg.norm(quaternion))), (3, 3))


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "options": (options, 600),
    "bom": (bom, 200),
    "devices": (devices, 240),
    "scales": (scales, 120),
}
