"""The cases: a family and a number make a folder of damaged input and the command that meets it.

Everything random comes from a generator that is seeded with `SEED`, the family and the number, so
that `python -m tests.fuzz.worker FAMILY NUMBER` repeats a case.
"""

from __future__ import annotations

import copy
import functools
import json
import operator
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.fuzz import inputs
from tests.fuzz.damage import (
    ODD_FLOATS,
    ODD_TEXTS,
    ODD_VALUES,
    bytes_damaged,
    tree_damaged,
    words_damaged,
)

SEED = 20_260
Command = list[str]
"""The engine's command line; 'decode SCENE' stands for loading a scene and all its photos."""


class Case(list[str]):
    """A command with what may become of it.

    Attributes:
        statuses: the exit statuses that are right.
        names: one of these must be in the line of an error; none: any line will do.
    """

    def __init__(
        self,
        command: Command,
        *,
        statuses: tuple[int, ...] = (0, 2),
        names: tuple[str, ...] = (),
    ) -> None:
        super().__init__(command)
        self.statuses, self.names = statuses, names


DISTORTED = (
    *("OPENCV", "SIMPLE_RADIAL", "FULL_OPENCV", "OPENCV_FISHEYE", "FOV", "THIN_PRISM_FISHEYE"),
    *("RAD_TAN_THIN_PRISM_FISHEYE", "DIVISION", "EUCM", "EQUIRECTANGULAR", "FISHEYE"),
)


def write(path: Path, data: bytes | str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data if isinstance(data, bytes) else data.encode("utf-8", "surrogatepass"))
    return path


def write_scene(folder: Path, files: dict[str, bytes], photos: dict[str, bytes]) -> None:
    for name, data in files.items():
        write(folder / "sparse" / "0" / name, data)
    for name, data in photos.items():
        write(folder / "images" / name, data)


PHOTOS = {name: inputs.photo("JPEG" if name.endswith("jpg") else "PNG") for name in inputs.NAMES}
MODEL = inputs.model()
QUICK = ["--steps-factor", "0.003", "--max-side", "24", "--threads", "1", "--test-every", "4",
         "--device", "cpu", "--seed", "1"]  # fmt: skip
"""Options of a training of a few steps."""


def good_scene(folder: Path) -> Path:
    write_scene(folder / "in", inputs.binary_files(MODEL), PHOTOS)
    return folder / "in"


def good_boxes(folder: Path) -> str:
    """A good `rois.json`."""
    return str(write(folder / "in" / "rois.json", json.dumps(inputs.ROIS)))


def looked_at(dice: random.Random, folder: Path) -> Command:
    """A command that reads the scene in `folder`/in and says or writes something about it."""
    scene, out = str(folder / "in"), str(folder / "out")
    rois = good_boxes(folder)
    method = dice.choice(("coverage", "static", "greedy", "fvs", "random"))
    return dice.choice(
        (
            ["inspect", scene, "--rois", rois],
            ["export", scene, "--out", out],
            ["select", scene, "--rois", rois, "--out", out, "--method", method],
            ["select", scene, "--rois", rois, "--out", out, "--test-every", "2"],
            ["decode", scene],
        )
    )


def model_values(dice: random.Random, folder: Path) -> Command:
    """A model with wrong numbers, names, ids or counts in otherwise well-formed files."""
    tree = tree_damaged(dice, MODEL, same_type=True, most=4)
    if dice.random() < 0.2:
        tree["images"] = [[*i[:4], []] for i in tree.get("images", [])]
    if dice.random() < 0.15:
        for image in tree.get("images", []):
            if len(image) > 3:
                image[3] = dice.choice(ODD_TEXTS)
    try:
        files = (inputs.binary_files if dice.random() < 0.6 else inputs.text_files)(tree)
    except (ValueError, TypeError, IndexError, KeyError):  # no file has that form
        files = inputs.binary_files(MODEL)
    write_scene(folder / "in", files, PHOTOS)
    return looked_at(dice, folder)


def model_bytes(dice: random.Random, folder: Path) -> Command:
    """A binary model with damaged bytes."""
    files = inputs.binary_files(MODEL)
    name = dice.choice(("cameras.bin", "images.bin", "points3D.bin"))
    files[name] = bytes_damaged(dice, files[name])
    write_scene(folder / "in", files, PHOTOS)
    return looked_at(dice, folder)


def model_text(dice: random.Random, folder: Path) -> Command:
    """A text model with damaged words, lines or bytes."""
    files = inputs.text_files(MODEL)
    name = dice.choice(list(files))
    files[name] = (
        words_damaged(dice, files[name].decode()).encode()
        if dice.random() < 0.7
        else bytes_damaged(dice, files[name])
    )
    write_scene(folder / "in", files, PHOTOS)
    return looked_at(dice, folder)


def lenses(dice: random.Random, folder: Path) -> Command:
    """Cameras with distortion, also absurd ones: they go through pycolmap."""
    name = dice.choice(DISTORTED)
    count = inputs_parameters(name)
    params = [45.0, 40.0, 23.0, 19.0][: min(count, 4)]
    if name in ("SIMPLE_RADIAL",):
        params = [45.0, 23.0, 19.0]
    params += [dice.uniform(-0.2, 0.2) for _ in range(count - len(params))]
    for _ in range(dice.randint(0, 2)):
        params[dice.randrange(count)] = dice.choice((*ODD_FLOATS, 1e-9, 1e4, 1e6, -5.0, 100.0, 3.2))
    tree = inputs.model(name, params)
    if dice.random() < 0.3:
        tree["cameras"][0][2:4] = [
            dice.choice((1, 2, 96, 4800, 1 << 20)),
            dice.choice((1, 72, 3600)),
        ]
    files = (inputs.binary_files if dice.random() < 0.5 else inputs.text_files)(tree)
    write_scene(folder / "in", files, PHOTOS)
    return dice.choice((["decode", str(folder / "in")], looked_at(dice, folder)))


def inputs_parameters(name: str) -> int:
    from roigs_engine.colmap.records import PARAMETER_COUNT

    return PARAMETER_COUNT[name]


FORMS = (
    *(("PNG", mode) for mode in ("RGB", "RGBA", "L", "LA", "P", "1", "I;16")),
    *(("JPEG", mode) for mode in ("RGB", "L", "CMYK")),
    *(
        ("TIFF", mode)
        for mode in ("RGB", "RGBA", "CMYK", "L", "1", "LAB", "YCbCr", "F", "I;16", "P")
    ),
    *(("BMP", mode) for mode in ("RGB", "L", "P")),
    *(("WEBP", "RGB"), ("WEBP", "RGBA"), ("JPEG2000", "RGB"), ("PPM", "RGB"), ("PPM", "L")),
    *(
        ("GIF", "P"),
        ("TGA", "RGB"),
        ("PCX", "RGB"),
        ("EPS", "RGB"),
        ("ICO", "RGBA"),
        ("SGI", "RGB"),
    ),
)


def photos(dice: random.Random, folder: Path) -> Command:
    """Photos of every kind, damaged, empty, of another size, or larger than any memory."""
    width, height = inputs.WIDTH, inputs.HEIGHT
    files: dict[str, bytes] = dict(PHOTOS)
    tree = inputs.model()
    for name in dice.sample(inputs.NAMES, dice.randint(1, 4)):
        form, mode = dice.choice(FORMS)
        size = dice.choice(((width, height),) * 6 + ((height, width), (24, 18), (480, 360), (1, 1)))
        data = inputs.photo(form, mode, size)
        match dice.randrange(10):
            case 0:
                data = b""
            case 1:
                data = data[: dice.randrange(len(data))]
            case 2:
                big = dice.choice(
                    ((480_000, 360_000), (40_000, 30_000), (15_000, 11_250), (2**31 - 1, 2**31 - 1))
                )
                data = inputs.png_of_claimed_size(*big)
                tree["cameras"][0][2:4] = [min(side, 1 << 20) for side in big]
            case 3:
                data = inputs.jpeg_of_claimed_size(
                    *dice.choice(((65_500, 49_125), (4800, 3600), (96, 72)))
                )
            case 4:
                data = inputs.turned_photo()
            case 5 | 6 | 7:
                data = bytes_damaged(dice, data)
        files[name] = data
    if dice.random() < 0.2:
        tree["cameras"][0][2:4] = dice.choice(([480_000, 360_000], [4800, 3600], [36, 48], [1, 1]))
    write_scene(folder / "in", inputs.binary_files(tree), files)
    name = folder / "in" / "images" / dice.choice(inputs.NAMES)
    if dice.random() < 0.15 and hasattr(os, "mkfifo"):
        name.unlink()
        match dice.randrange(5):
            case 0:
                name.mkdir()
            case 1:
                name.symlink_to(name)
            case 2:
                name.symlink_to("/dev/zero")
            case 3:
                name.symlink_to(folder / "in" / "images", target_is_directory=True)
            case _:
                os.mkfifo(name)
    return dice.choice((["decode", str(folder / "in")],) * 3 + (looked_at(dice, folder),))


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


Family = Callable[[random.Random, Path], Command]
FAMILIES: dict[str, tuple[Family, int]] = {
    "model_values": (model_values, 900),
    "model_bytes": (model_bytes, 750),
    "model_text": (model_text, 550),
    "lenses": (lenses, 300),
    "photos": (photos, 700),
    "gaussians": (gaussians, 750),
    "rois": (rois, 450),
    "requests": (requests, 600),
    "selections": (selections, 150),
    "paths": (paths, 220),
    "splits": (splits, 50),
}
"""Family -> how a case is made, and how many there are in the long run; `all_families` has more."""


def all_families() -> dict[str, tuple[Family, int]]:
    """All families of all files."""
    from tests.fuzz import exchange, levels_and_scribbles, masks, run_folders, texts, user_input

    others = (run_folders, user_input, texts, exchange, masks, levels_and_scribbles)
    return functools.reduce(operator.or_, (room.FAMILIES for room in others), FAMILIES)


def make(family: str, number: int, folder: Path) -> Case:
    """Write the case below `folder`; its command."""
    made = all_families()[family][0](random.Random(f"{SEED}/{family}/{number}"), folder)
    return made if isinstance(made, Case) else Case(made)
