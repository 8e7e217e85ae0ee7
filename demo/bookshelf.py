# SPDX-License-Identifier: GPL-3.0-or-later
"""A bookshelf with books and trinkets."""

from __future__ import annotations

import bpy
import numpy as np
import textures as tx
from build import box, image, image_material, lathe, place, text
from materials import PINE, Library
from mathutils import Matrix
from measures import HALF_X

WORDS_A = [
    "QUIET",
    "LAST",
    "NORTH",
    "SILVER",
    "WINTER",
    "LITTLE",
    "LONG",
    "BROKEN",
    "GREEN",
    "SECOND",
    "HIDDEN",
    "OLD",
]
WORDS_B = [
    "RIVER",
    "HARBOUR",
    "GARDEN",
    "LETTER",
    "ATLAS",
    "VOYAGE",
    "ORCHARD",
    "CLOCK",
    "MAP",
    "SONG",
    "TOWER",
    "FIELD",
]


def bookshelf(lib: Library) -> None:
    """A tall shelf on the east wall, full of books that differ in size, colour and title."""
    rng = np.random.default_rng(61)
    frame = place((HALF_X - 0.02, 0.05, 0), (0, 0, -90))
    width, depth, height = 1.9, 0.3, 2.05
    for k, x in enumerate((-width / 2, 0.0, width / 2)):
        box(
            f"shelf side {k}",
            (0.03, depth, height),
            (x, -depth / 2, height / 2),
            lib.dark,
            frame,
            0.003,
        )
    levels = np.linspace(0.08, height - 0.02, 6)
    for k, z in enumerate(levels):
        box(f"shelf board {k}", (width, depth, 0.026), (0, -depth / 2, z), lib.dark, frame, 0.003)
    box("shelf back", (width, 0.012, height), (0, -0.006, height / 2), lib.light, frame)
    cloth = image("cloth", tx.plaster(512, 512, 62, (1.0, 1.0, 1.0), (0.55, 0.55, 0.55)))
    pages = image_material("pages", image("pages", tx.wood(256, 256, 63, PINE, 40.0)), (0.2, 0.2))
    for level, z in enumerate(levels[:-1]):
        room_above = levels[level + 1] - z - 0.03
        for half, (start, end) in enumerate(((-width / 2 + 0.03, -0.03), (0.03, width / 2 - 0.03))):
            x, k = start, 0
            while x < end - 0.06:
                if rng.random() < 0.06 and x < end - 0.25:
                    trinket(f"trinket {level}{half}{k}", x + 0.1, z + 0.013, frame, rng)
                    x += 0.2
                else:
                    wide = rng.uniform(0.018, 0.055)
                    tall = rng.uniform(0.6, 0.97) * min(room_above, 0.32)
                    deep = rng.uniform(0.15, 0.23)
                    spot = frame @ place((x + wide / 2, -0.02, z + 0.013))
                    name = f"book {level} {half} {k}"
                    book(name, (wide, deep, tall), spot, cloth, pages, lib, rng)
                    x += wide + (0.0015 if rng.random() < 0.93 else rng.uniform(0.02, 0.07))
                k += 1


def book(
    name: str,
    size: tuple[float, float, float],
    frame: Matrix,
    cloth: bpy.types.Image,
    pages: bpy.types.Material,
    lib: Library,
    rng: np.random.Generator,
) -> None:
    """One upright book, spine to -Y, with bands and a title."""
    wide, deep, tall = size
    tone = np.array(tx.WARM[rng.integers(len(tx.WARM))]) * rng.uniform(0.55, 1.2)
    tone = tuple(np.clip(tone + rng.uniform(-0.08, 0.08, 3), 0.03, 0.95))
    mat = image_material(name, cloth, (0.16, 0.16), tint=tone)
    box(name, size, (0, -deep / 2, tall / 2), mat, frame, min(0.003, wide / 6))
    box(
        f"{name} pages",
        (wide * 0.8, deep * 0.94, 0.002),
        (0, -deep / 2 + 0.004, tall + 0.0005),
        pages,
        frame,
    )
    ink = lib.gold if sum(tone) < 1.5 else lib.ink
    for k, z in enumerate(rng.uniform(0.04, 0.2, 3)):
        spot = z * tall if k < 2 else tall * (1 - z)
        box(
            f"{name} band {k}",
            (wide * 1.01, 0.002, rng.uniform(0.002, 0.008)),
            (0, -deep, spot),
            ink,
            frame,
        )
    title = f"{WORDS_A[rng.integers(len(WORDS_A))]} {WORDS_B[rng.integers(len(WORDS_B))]}"
    spot = frame @ place((0, -deep - 0.0006, tall * 0.55), (0, 90, 0))
    text(f"{name} title", title, min(0.026, wide * 0.6), ink, spot, 0.0004, tall * 0.62)


def trinket(name: str, x: float, z: float, frame: Matrix, rng: np.random.Generator) -> None:
    """A small painted pot between the books."""
    pixels = tx.fabric(256, 256, int(rng.integers(1000)), (0.8, 0.76, 0.66), tx.WARM, 40)
    mat = image_material(name, image(name, pixels), (0.3, 0.3))
    neck = rng.uniform(0.02, 0.05)
    shape = (
        (0.001, 0),
        (0.045, 0),
        (rng.uniform(0.05, 0.075), 0.07),
        (neck, 0.13),
        (neck + 0.012, 0.16),
    )
    lathe(name, shape, mat, frame @ place((x, -0.14, z)))
