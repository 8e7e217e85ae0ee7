"""Family: masks of photos, of every kind, damaged, of another size, for unknown photos."""

from __future__ import annotations

import io
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from tests.fuzz import inputs
from tests.fuzz.cases import QUICK, Case, good_boxes, good_scene, write
from tests.fuzz.damage import bytes_damaged

SIZES = ((inputs.WIDTH, inputs.HEIGHT),) * 5 + ((24, 18), (480, 360), (36, 48), (1, 1), (47, 36))
PLACES = ("masks/{}.png", "masks/{}.png", "masks/{stem}.png", "images/{stem}.mask.png",
          "images/{}.mask.png", "masks/thing/{}.png", "masks/other.png", "masks/{}")  # fmt: skip


def mask(dice: random.Random) -> bytes:
    """A mask, or something else in its place."""
    width, height = dice.choice(SIZES)
    share = dice.choice((0.0, 0.02, 0.5, 0.98, 1.0))
    bright = np.random.default_rng(dice.randrange(1 << 30)).random((height, width)) < share
    image = Image.fromarray(bright)
    form, file = "PNG", io.BytesIO()
    match dice.randrange(12):
        case 0 | 1:
            pass
        case 2:
            image = Image.fromarray(bright.astype(np.uint16) * dice.choice((1, 257, 65_535)))
        case 3:
            image = Image.fromarray(bright.astype(np.uint8) * dice.choice((1, 7, 255)))
            image.putpalette(bytes(range(256)) * 3)
        case 4:
            frames = [image.convert("L"), Image.new("L", image.size)]
            frames[0].save(file, "PNG", save_all=True, append_images=frames[1:])
            return file.getvalue()
        case 5:
            return inputs.png_of_claimed_size(*dice.choice(((480_000, 360_000), (4800, 3600))))
        case 6:
            return dice.choice((b"", b"P", b"\x89PNG\r\n\x1a\n", b"text" * 40))
        case 7:
            image, form = image.convert("RGB"), dice.choice(("JPEG", "GIF", "BMP", "TIFF", "WEBP"))
        case _:
            image = image.convert(dice.choice(("L", "LA", "P", "RGB", "RGBA")))
    image.save(file, form)
    data = file.getvalue()
    return bytes_damaged(dice, data) if dice.random() < 0.3 else data


def masks(dice: random.Random, folder: Path) -> Case:
    """Masks of some photos, in all places, for the commands that read them."""
    scene, out = good_scene(folder), str(folder / "out")
    for name in dice.sample(inputs.NAMES, dice.randint(1, 4)):
        place = dice.choice(PLACES).format(name, stem=Path(name).stem)
        if place != f"images/{name}":
            write(scene / place, mask(dice))
    if dice.random() < 0.3:  # transparent parts of the photos themselves
        photo = Image.open(io.BytesIO(inputs.photo())).convert("RGBA")
        photo.putalpha(dice.choice((0, 90, 200, 255)))
        file = io.BytesIO()
        photo.save(file, "PNG")
        write(scene / "images" / dice.choice(inputs.NAMES), file.getvalue())
    rois = good_boxes(folder)
    more = dice.choice(
        (
            [],
            [],
            ["--no-masks"],
            ["--no-object-masks"],
            ["--invert-masks"],
            ["--masks", str(scene / "masks")],
            ["--masks", str(scene / "images")],
        )
    )
    ply = str(write(folder / "in" / "a.ply", inputs.good_ply()))
    if dice.random() < 0.3:
        line = ["cut", str(scene), "--rois", rois, "--model", ply, "--out", out, "--device", "cpu"]
        return Case([*line, *(word for word in more if not word.startswith("--no-"))])
    if dice.random() < 0.3:
        line = ["train", str(scene), "--rois", rois, "--run-dir", out, *QUICK]
        return Case([*line, *more])
    line = ["evaluate", str(scene), "--rois", rois, "--model", f"A={ply}", "--device", "cpu"]
    return Case([*line, "--max-side", "24", "--out", out, *more])


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {"masks": (masks, 500)}
