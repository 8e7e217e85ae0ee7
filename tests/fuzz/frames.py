"""Family: requests of `render-frames`, with damaged values and arrays, in a folder of the output.

Whoever writes requests chooses where pictures go, so `out` is good or no path at all.
"""

from __future__ import annotations

import io
import json
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz import inputs
from tests.fuzz.cases import Case, json_bytes, odd_tree, write
from tests.fuzz.damage import bytes_damaged

SIDES = (12, 9)
NO_NAMES = ("/", "a\0b", "\ud800", 5, None, [], True)


def head(text: str) -> bytes:
    """The begin of a .npy file with this header."""
    return b"\x93NUMPY\1\0" + len(text).to_bytes(2, "little") + text.encode()


HEADS = (
    *(b"", b"PK\3\4", b"\x93NUMPY", head("("), head("-" * 4095)),
    head("{'descr': '<f4', 'fortran_order': False, 'shape': (1099511627776, 3, 3)}"),
    head("{'descr': '|O', 'fortran_order': False, 'shape': (3,)}"),
)
"""How files begin that numpy's reader takes for its own, or for an archive."""


def array(dice: random.Random) -> bytes:
    """A .npy file: triangles or rays, of another shape or kind, or damaged."""
    shape = dice.choice(((4, 3, 3), (SIDES[1], SIDES[0], 3), (0, 3, 3), (3,), (), (2, 2)))
    numbers = np.random.default_rng(dice.randrange(99)).normal(size=shape) * 10.0 ** dice.choice(
        (0, 0, 30, -30)
    )
    kind = dice.choice(("<f4", "<f4", "<f8", ">f4", "<i4", "<c8"))
    with io.BytesIO() as file:
        np.save(file, numbers.astype(kind))
        data = file.getvalue()
    match dice.randrange(4):
        case 0:
            return dice.choice(HEADS) + bytes(200)
        case 1:
            return bytes_damaged(dice, data)
    return data


def frame_requests(dice: random.Random, folder: Path) -> Case:
    """One or two requests, answered once."""
    requests = folder / "out" / "requests"
    write(folder / "in" / "a.ply", inputs.good_ply())
    write(folder / "in" / "a.npy", array(dice))
    if os.name == "posix":
        os.mkfifo(folder / "in" / "pipe")
    camera: dict[str, Any] = {"name": "1", "width": SIDES[0], "height": SIDES[1]}
    camera |= {"fx": 10.0, "fy": 10.0, "cx": 6.0, "cy": 4.5}
    camera["world_to_camera"] = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
    model = {
        "ply": "../../in/a.ply",
        "matrix": np.eye(4).tolist(),
        "gains": [1, 2, 1],
        "object_index": 3,
    }
    for number in range(dice.choice((1, 1, 2))):
        tree: Any = {"camera": camera, "models": [model | {"density": 0.5}], "transparent": True}
        tree["mattes"] = dice.random() < 0.5
        for name in dice.sample(("surfaces", "rays"), dice.choice((0, 0, 1, 1, 2))):
            tree[name] = dice.choice(
                ("../../in/a.npy", "../../in/a.npy", "../../in/pipe", "/dev/zero")
            )
        if dice.random() < 0.3:
            tree = {"samples": [tree] * dice.randint(0, 3)}
        if dice.random() < 0.5:
            tree = odd_tree(dice, tree)
        if isinstance(tree, dict):
            tree["out"] = "../answer" if dice.random() < 0.8 else dice.choice(NO_NAMES)
        data = json_bytes(dice, tree) if dice.random() < 0.9 else json.dumps(tree).encode()[:-9]
        write(requests / f"{number}.json", data)
    if dice.random() < 0.1:
        (requests / "9.json").mkdir()
    keeps = dice.random() < 0.3
    if keeps:  # before or behind the requests
        name = dice.choice(("!boxes.json", "rois.json"))
        write(requests / name, json.dumps(dice.choice((inputs.ROIS, inputs.camera_path(), []))))
    line = ["render-frames", str(requests), "--once", "--threads", "1", "--device", "cpu"]
    return Case(line, keeps=(f"out/requests/{name}",) if keeps else ())


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "frame_requests": (frame_requests, 300),
}
