"""Damaged scenes: COLMAP models and photos."""

from __future__ import annotations

import functools
import os
import random
import tempfile
from pathlib import Path

from tests.engine.colmap.bent_models import bent
from tests.fuzz import inputs
from tests.fuzz.cases import MODEL, Command, Family, good_boxes, good_photos, write_scene
from tests.fuzz.damage import (
    ODD_FLOATS,
    ODD_TEXTS,
    bytes_damaged,
    tree_damaged,
    words_damaged,
)

DISTORTED = (
    *("OPENCV", "SIMPLE_RADIAL", "FULL_OPENCV", "OPENCV_FISHEYE", "FOV", "THIN_PRISM_FISHEYE"),
    *("RAD_TAN_THIN_PRISM_FISHEYE", "DIVISION", "EUCM", "EQUIRECTANGULAR", "FISHEYE"),
)


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
    write_scene(folder / "in", files, good_photos())
    return looked_at(dice, folder)


def model_bytes(dice: random.Random, folder: Path) -> Command:
    """A binary model with damaged bytes."""
    files = inputs.binary_files(MODEL)
    name = dice.choice(("cameras.bin", "images.bin", "points3D.bin"))
    files[name] = bytes_damaged(dice, files[name])
    write_scene(folder / "in", files, good_photos())
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
    write_scene(folder / "in", files, good_photos())
    return looked_at(dice, folder)


@functools.cache
def _tracked() -> dict[str, bytes]:
    """The files of a model whose points many photos observe, rigs and frames among them."""
    with tempfile.TemporaryDirectory() as name:
        place = bent(Path(name), photos=6).folder / "sparse/0"
        return {file.name: file.read_bytes() for file in place.iterdir()}


def refined_models(dice: random.Random, folder: Path) -> Command:
    """A binary model with damaged bytes, also in its rigs and frames, which pycolmap reads."""
    files = dict(_tracked())
    name = dice.choice(sorted(files))
    files[name] = bytes_damaged(dice, files[name])
    write_scene(folder / "in", files, {})
    scene, out = str(folder / "in"), str(folder / "out" / "refined")
    return ["refine-cameras", scene, "--tracks-only", "--out", out]


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
    write_scene(folder / "in", files, good_photos())
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
    files: dict[str, bytes] = dict(good_photos())
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


FAMILIES: dict[str, tuple[Family, int]] = {
    "model_values": (model_values, 900),
    "model_bytes": (model_bytes, 750),
    "model_text": (model_text, 550),
    "refined_models": (refined_models, 200),
    "lenses": (lenses, 300),
    "photos": (photos, 700),
}
