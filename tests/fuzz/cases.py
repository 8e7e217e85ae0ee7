"""The cases: a family and a number make a folder of damaged input and the command that meets it.

Everything random comes from a generator that is seeded with `SEED`, the family and the number, so
that `python -m tests.fuzz.worker FAMILY NUMBER` repeats a case.
"""

from __future__ import annotations

import copy
import functools
import json
import operator
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fuzz import inputs
from tests.fuzz.damage import (
    ODD_VALUES,
    bytes_damaged,
    tree_damaged,
)

SEED = 20_260
Command = list[str]
"""The engine's command line; 'decode SCENE' stands for loading a scene and all its photos."""


class Case(list[str]):
    """A command with what may become of it.

    Attributes:
        statuses: the exit statuses that are right.
        names: one of these must be in the line of an error; none: any line will do.
        keeps: files of the user's in the case's folder that stay as they are.
    """

    def __init__(
        self,
        command: Command,
        *,
        statuses: tuple[int, ...] = (0, 2),
        names: tuple[str, ...] = (),
        keeps: tuple[str, ...] = (),
    ) -> None:
        super().__init__(command)
        self.statuses, self.names, self.keeps = statuses, names, keeps


def write(path: Path, data: bytes | str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data if isinstance(data, bytes) else data.encode("utf-8", "surrogatepass"))
    return path


def write_scene(folder: Path, files: dict[str, bytes], photos: dict[str, bytes]) -> None:
    for name, data in files.items():
        write(folder / "sparse" / "0" / name, data)
    for name, data in photos.items():
        write(folder / "images" / name, data)


@functools.cache
def good_photos() -> dict[str, bytes]:
    """The photos of a scene, by name; made when asked for, as Blender's Python has no Pillow."""
    kinds = {name: "JPEG" if name.endswith("jpg") else "PNG" for name in inputs.NAMES}
    return {name: inputs.photo(kind) for name, kind in kinds.items()}


MODEL = inputs.model()
QUICK = ["--steps-factor", "0.003", "--max-side", "24", "--threads", "1", "--test-every", "4",
         "--device", "cpu", "--seed", "1"]  # fmt: skip
"""Options of a training of a few steps."""


def good_scene(folder: Path) -> Path:
    write_scene(folder / "in", inputs.binary_files(MODEL), good_photos())
    return folder / "in"


def good_boxes(folder: Path) -> str:
    """A good `rois.json`."""
    return str(write(folder / "in" / "rois.json", json.dumps(inputs.ROIS)))


def json_bytes(dice: random.Random, value: Any) -> bytes:
    """The value as JSON; now and then with damaged text, in another encoding, or far too deep."""
    data = json.dumps(value, ensure_ascii=dice.random() < 0.5).encode("utf-8", "surrogatepass")
    match dice.randrange(16):
        case 0:
            return bytes_damaged(dice, data)
        case 1:
            return dice.choice(
                (b"", b"[" * 200_000, b'{"a":' * 100_000, b"\xff\xfe" + data, b"null", b"1" * 9000)
            )
        case 2:
            return data.decode("utf-8", "replace").encode("utf-16")
    return data


def odd_tree(dice: random.Random, tree: Any) -> Any:
    """The tree with values that may be of any type, or something else altogether."""
    if dice.random() < 0.2:
        return copy.deepcopy(tree if dice.random() < 0.8 else dice.choice(ODD_VALUES))
    return tree_damaged(dice, tree, most=dice.choice((1, 1, 3)))


Family = Callable[[random.Random, Path], Command]
"""Makes a case. Each file of cases has a table FAMILIES: name -> how a case is made, and how many
there are in the long run."""


def all_families() -> dict[str, tuple[Family, int]]:
    """All families of all files."""
    from tests.fuzz import (
        amplified,
        command_files,
        exchange,
        foreign_folders,
        frames,
        guidance,
        levels_and_scribbles,
        masks,
        meshes,
        names,
        pictures,
        run_folders,
        scenes,
        sizes,
        stores,
        texts,
        user_input,
        videos,
        work_folders,
        working_folders,
    )

    files = (
        scenes,
        pictures,
        command_files,
        run_folders,
        user_input,
        texts,
        exchange,
        foreign_folders,
        frames,
        guidance,
        meshes,
        masks,
        sizes,
        stores,
        names,
        videos,
        work_folders,
        working_folders,
        amplified,
    )
    tables = [file.FAMILIES for file in (*files, levels_and_scribbles)]
    return functools.reduce(operator.or_, tables)


def make(family: str, number: int, folder: Path) -> Case:
    """Write the case below `folder`; its command."""
    made = all_families()[family][0](random.Random(f"{SEED}/{family}/{number}"), folder)
    return made if isinstance(made, Case) else Case(made)
