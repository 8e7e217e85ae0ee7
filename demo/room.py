# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo room and its furniture: x to the east, y to the north, z up, metres."""

from __future__ import annotations

import math

import bpy
import numpy as np
import textures as tx
from build import (
    IDENTITY,
    box,
    image,
    image_material,
    lathe,
    panel,
    place,
    plain_material,
    sheet,
    text,
)
from mathutils import Matrix

HALF_X, HALF_Y, HEIGHT = 2.6, 2.2, 2.6
TABLE_TOP = 0.76
SIDEBOARD = {"centre": (0.35, -1.96), "top": 0.86}

OAK = ((0.38, 0.24, 0.14), (0.50, 0.33, 0.20), (0.60, 0.43, 0.27))
WALNUT = ((0.20, 0.12, 0.08), (0.29, 0.18, 0.12), (0.38, 0.25, 0.16))
PINE = ((0.60, 0.43, 0.25), (0.70, 0.53, 0.33), (0.78, 0.62, 0.42))

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


class Library:
    """The materials that several pieces of furniture share."""

    def __init__(self) -> None:
        self.oak = image("oak", tx.wood(1536, 1024, 11, OAK, 8.0))
        self.walnut = image("walnut", tx.wood(1536, 1024, 12, WALNUT, 10.0))
        self.pine = image("pine", tx.wood(1024, 1024, 13, PINE, 7.0))
        self.table = image_material("table oak", self.oak, (1.7, 0.95), 0.0006)
        self.dark = image_material("walnut", self.walnut, (1.3, 0.6), 0.0006)
        self.light = image_material("pine", self.pine, (1.2, 0.7), 0.0006)
        paint = tx.plaster(1024, 1024, 14, (0.93, 0.91, 0.86), (0.80, 0.77, 0.70))
        self.paint = image_material("white paint", image("paint", paint), (1.0, 1.0), 0.001)
        self.brass = plain_material("brass", (0.67, 0.50, 0.22))
        self.ink = plain_material("ink", (0.09, 0.08, 0.08))
        self.gold = plain_material("gold lettering", (0.86, 0.72, 0.38))


def build_room(lib: Library) -> None:
    """The whole room without the objects that get a box."""
    shell(lib)
    window(lib)
    pictures(lib)
    door(lib)
    bookshelf(lib)
    table(lib)
    chairs(lib)
    sideboard(lib)
    armchair(lib)
    plant(lib)
    lamps(lib)


def shell(lib: Library) -> None:
    """Floor, ceiling with beams, papered walls with dado, skirting and rail, the rug."""
    boards = image("floor", tx.floor(2080, 1760, 31, 21))
    mat = image_material("floor", boards, (2 * HALF_X, 2 * HALF_Y), 0.0015)
    panel("floor", (2 * HALF_X, 2 * HALF_Y), mat, place(turn=(-90, 0, 0)))
    top = image("ceiling", tx.plaster(1536, 1536, 22, (0.92, 0.90, 0.86), (0.76, 0.73, 0.68)))
    mat = image_material("ceiling", top, (2 * HALF_X, 2 * HALF_X), 0.004)
    panel("ceiling", (2 * HALF_X, 2 * HALF_Y), mat, place((0, 0, HEIGHT), (90, 0, 0)))
    for k, x in enumerate((-1.75, -0.1, 1.6)):
        box(f"beam {k}", (0.16, 2 * HALF_Y, 0.14), (x, 0, HEIGHT - 0.07), lib.dark, bevel=0.008)
    walls = {
        "north": (2 * HALF_X, (0, HALF_Y), 0),
        "east": (2 * HALF_Y, (HALF_X, 0), -90),
        "south": (2 * HALF_X, (0, -HALF_Y), 180),
        "west": (2 * HALF_Y, (-HALF_X, 0), 90),
    }
    for k, (name, (width, (x, y), turn)) in enumerate(walls.items()):
        paper = image(f"paper {name}", tx.wallpaper(2048 if width > 5 else 1734, 1024, 30 + k))
        mat = image_material(f"paper {name}", paper, (width, HEIGHT))
        frame = place((x, y, HEIGHT / 2), (0, 0, turn))
        panel(f"wall {name}", (width, HEIGHT), mat, frame)
        floor_frame = place((x, y, 0), (0, 0, turn))
        trim = ((0.13, 0.02, 0.065), (0.05, 0.03, 0.92), (0.09, 0.04, HEIGHT - 0.045))
        for n, (tall, deep, z) in enumerate(trim):
            mat = lib.paint if n != 1 else lib.light
            size, centre = (width, deep, tall), (0, -deep / 2, z)
            box(f"trim {name} {n}", size, centre, mat, floor_frame, 0.006)
    mat = image_material("rug", image("rug", tx.rug(1920, 1344, 23)), (3.0, 2.1), 0.002)
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:22, 0:31]
    wave = 0.008 + 0.004 * rng.random(y.shape)
    points = np.stack([x / 10 - 1.5, y / 10 - 1.05, wave], -1)
    sheet("rug", points, (3.0, 2.1), mat, place((0.05, 0.0, 0.0), (0, 0, 3)))


def window(lib: Library) -> None:
    """A window on the north wall: a bright painted view, frame, sill and curtains."""
    x, z, width, height = -0.55, 1.55, 1.5, 1.2
    view = image("view", tx.landscape(1280, 1024, 41))
    mat = image_material("view", view, (width, height), emission=0.75)
    panel("window view", (width, height), mat, place((x, HALF_Y - 0.012, z)))
    front = HALF_Y - 0.03
    for k, dx in enumerate((-0.75, -0.25, 0.25, 0.75)):
        wide = 0.09 if k in (0, 3) else 0.035
        box(
            f"window post {k}",
            (wide, 0.06, height + 0.1),
            (x + dx, front, z),
            lib.paint,
            bevel=0.006,
        )
    for k, dz in enumerate((-0.6, 0.12, 0.6)):
        tall = 0.035 if k == 1 else 0.09
        box(
            f"window bar {k}",
            (width + 0.1, 0.055, tall),
            (x, front, z + dz),
            lib.paint,
            bevel=0.006,
        )
    box("sill", (width + 0.25, 0.2, 0.04), (x, HALF_Y - 0.1, z - 0.66), lib.light, bevel=0.008)
    cloth = tx.fabric(1024, 1536, 42, (0.60, 0.34, 0.26), tx.WARM[1:5] + tx.LEAVES[:2], 260)
    mat = image_material("curtain", image("curtain", cloth), (0.9, 1.75))
    mirrored = image_material(
        "curtain 2", image("curtain 2", cloth[:, ::-1].copy()), (0.9, 1.75), 0.95
    )
    v, u = np.mgrid[0:30, 0:120]
    u, v = u / 119.0, v / 29.0
    fold = 0.03 * np.sin(u * 44.0 + 1.5 * np.sin(4 * v)) * (1.1 - 0.4 * v)
    for side, material in ((-1, mat), (1, mirrored)):
        spread = (u - 0.5) * 0.52 * (1.0 - 0.16 * np.sin(np.pi * v))
        points = np.stack([spread, fold, v * 1.75], -1)
        sheet(
            f"curtain {side}", points, (0.9, 1.75), material, place((x + side * 0.98, 2.09, 0.55))
        )
    turn = place((x - 1.3, 2.08, 2.32), (0, 90, 0))
    lathe("curtain rod", ((0.014, 0.0), (0.014, 2.6)), lib.dark, turn, 16)
    items = ("jug", "pot", "bottle")
    for k, name in enumerate(items):
        shape = ((0.001, 0), (0.05, 0), (0.062, 0.06), (0.03 + 0.01 * k, 0.14), (0.042, 0.17))
        pixels = tx.fabric(512, 512, 45 + k, tx.WARM[3 - k], tx.LEAVES + tx.WARM[:2], 60)
        mat = image_material(f"sill {name}", image(f"sill {name}", pixels), (0.35, 0.35))
        lathe(f"sill {name}", shape, mat, place((x - 0.4 + 0.37 * k, HALF_Y - 0.1, z - 0.64)))


def framed(
    name: str, pixels: np.ndarray, size: tuple[float, float], frame: Matrix, lib: Library
) -> None:
    """A picture with mount and frame; the frame's origin lies on the wall, facing -Y."""
    w, h = size
    mat = image_material(name, image(name, pixels), size)
    panel(f"{name} canvas", size, mat, frame @ place((0, -0.018, 0)))
    box(f"{name} mount", (w + 0.08, 0.012, h + 0.08), (0, -0.008, 0), lib.paint, frame)
    wood = lib.dark if len(name) % 2 else lib.light
    for k, sign in enumerate((-1, 1)):
        box(
            f"{name} a{k}",
            (w + 0.14, 0.035, 0.04),
            (0, -0.018, sign * (h / 2 + 0.05)),
            wood,
            frame,
            0.006,
        )
        box(
            f"{name} b{k}",
            (0.04, 0.035, h + 0.1),
            (sign * (w / 2 + 0.05), -0.018, 0),
            wood,
            frame,
            0.006,
        )


def pictures(lib: Library) -> None:
    """Pictures on all four walls, no two alike."""

    def on_wall(x: float, y: float, z: float, turn: float) -> Matrix:
        return place((x, y, z), (0, 0, turn))

    south, west, east = -HALF_Y, -HALF_X, HALF_X
    framed("map", tx.contour_map(1280, 880, 51), (1.05, 0.72), on_wall(0.35, south, 1.72, 180), lib)
    framed("patches", tx.patchwork(640, 800, 52), (0.4, 0.5), on_wall(1.55, south, 1.6, 180), lib)
    framed("bouquet", tx.bouquet(720, 960, 53), (0.54, 0.72), on_wall(west, 0.25, 1.65, 90), lib)
    framed("hills", tx.landscape(960, 640, 54), (0.66, 0.44), on_wall(west, -0.75, 1.75, 90), lib)
    framed("cubes", tx.patchwork(640, 640, 55), (0.4, 0.4), on_wall(west, -1.55, 1.5, 90), lib)
    framed("isle", tx.contour_map(640, 800, 56), (0.4, 0.5), on_wall(1.15, HALF_Y, 1.85, 0), lib)
    framed("posy", tx.bouquet(640, 640, 57), (0.36, 0.36), on_wall(1.75, HALF_Y, 1.55, 0), lib)
    framed("dunes", tx.landscape(640, 480, 58), (0.4, 0.3), on_wall(1.25, HALF_Y, 1.25, 0), lib)
    framed("valley", tx.landscape(640, 860, 59), (0.42, 0.56), on_wall(east, -1.6, 1.6, -90), lib)
    framed("study", tx.bouquet(640, 800, 60), (0.4, 0.5), on_wall(east, 1.65, 1.65, -90), lib)


def door(lib: Library) -> None:
    """A panelled door in the south wall."""
    frame = place((-1.65, -HALF_Y, 0), (0, 0, 180))
    box("door leaf", (0.84, 0.03, 2.02), (0, -0.015, 1.01), lib.light, frame)
    for k, (x, z, w, h) in enumerate(
        (
            (-0.2, 0.5, 0.3, 0.66),
            (0.2, 0.5, 0.3, 0.66),
            (-0.2, 1.42, 0.3, 0.9),
            (0.2, 1.42, 0.3, 0.9),
        )
    ):
        box(f"door panel {k}", (w, 0.02, h), (x, -0.035, z), lib.light, frame, 0.012)
        box(f"door field {k}", (w - 0.1, 0.02, h - 0.1), (x, -0.045, z), lib.dark, frame, 0.012)
    for k, x in enumerate((-0.48, 0.48)):
        box(f"door post {k}", (0.1, 0.05, 2.12), (x, -0.025, 1.06), lib.paint, frame, 0.01)
    box("door head", (1.08, 0.062, 0.1), (0, -0.031, 2.12), lib.paint, frame, 0.01)
    knob = ((0.001, 0), (0.02, 0), (0.012, 0.03), (0.028, 0.045), (0.024, 0.07), (0.001, 0.075))
    lathe("door knob", knob, lib.brass, frame @ place((0.36, -0.03, 1.0), (90, 0, 0)), 24)


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


def table(lib: Library) -> None:
    """The table in the middle, with a runner, a newspaper, a bowl of fruit and books."""
    box(
        "table top", (1.6, 0.9, 0.035), (0, 0, TABLE_TOP - 0.0175), lib.table, bevel=0.006, fit=True
    )
    for k, (sx, sy) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
        box(
            f"table leg {k}",
            (0.07, 0.07, 0.73),
            (sx * 0.72, sy * 0.37, 0.365),
            lib.table,
            bevel=0.006,
        )
    for k, sign in enumerate((-1, 1)):
        box(f"apron a{k}", (1.4, 0.022, 0.1), (0, sign * 0.37, 0.675), lib.table)
        box(f"apron b{k}", (0.022, 0.7, 0.1), (sign * 0.72, 0, 0.675), lib.table)
    pixels = tx.fabric(1600, 512, 71, (0.82, 0.78, 0.68), tx.WARM[:3] + tx.LEAVES[:3], 330)
    cloth = image_material("runner", image("runner", pixels), (1.25, 0.4), 0.0008)
    y, x = np.mgrid[0:9, 0:26]
    lift = TABLE_TOP + 0.0015 + 0.001 * np.random.default_rng(4).random(y.shape)
    sheet(
        "runner",
        np.stack([x / 20 - 0.625, y / 20 - 0.2, lift], -1),
        (1.25, 0.4),
        cloth,
        place(turn=(0, 0, 2)),
    )
    paper = image_material("paper", image("paper", tx.newsprint(840, 1100, 72)), (0.29, 0.38))
    y, x = np.mgrid[0:12, 0:12]
    bend = TABLE_TOP + 0.004 + 0.004 * np.sin(x / 3.0) * np.cos(y / 4.0) + 0.004
    points = np.stack([(x / 11 - 0.5) * 0.29, (y / 11 - 0.5) * 0.38, bend], -1)
    sheet("newspaper", points, (0.29, 0.38), paper, place((0.02, -0.2, 0), (0, 0, -24)))
    fruit_bowl(lib)
    cloth = image("covers", tx.filigree(512, 512, 73, (0.80, 0.76, 0.7), (0.5, 0.36, 0.2)))
    z = TABLE_TOP
    for k, (tone, turn) in enumerate((((0.6, 0.3, 0.25), 12), ((0.45, 0.6, 0.65), -6))):
        mat = image_material(f"cover {k}", cloth, (0.25, 0.25), tint=tone)
        tall = 0.03 + 0.008 * k
        frame = place((0.66, 0.3, z), (0, 0, turn))
        box(f"table book {k}", (0.2, 0.15, tall), (0, 0, tall / 2), mat, frame, 0.002)
        text(
            f"table book title {k}",
            ("TIDES", "MOSSES")[k],
            0.018,
            lib.ink,
            frame @ place((0, -0.0755, tall / 2)),
        )
        z += tall


def fruit_bowl(lib: Library) -> None:
    """A painted bowl with mottled fruit."""
    pixels = tx.fabric(1024, 256, 75, (0.84, 0.80, 0.70), tx.WARM[:3], 90)
    mat = image_material("bowl", image("bowl", pixels), (0.8, 0.2))
    shape = (
        (0.001, 0),
        (0.05, 0),
        (0.05, 0.012),
        (0.1, 0.05),
        (0.125, 0.085),
        (0.12, 0.085),
        (0.08, 0.04),
        (0.001, 0.02),
    )
    middle = (-0.02, 0.24, TABLE_TOP + 0.003)
    lathe("bowl", shape, mat, place(middle))
    tones = (((0.78, 0.22, 0.14), (0.86, 0.70, 0.24)), ((0.44, 0.58, 0.22), (0.74, 0.72, 0.34)))
    for k in range(5):
        pixels = tx.plaster(256, 256, 80 + k, *tones[k % 2])
        mat = image_material(f"fruit {k}", image(f"fruit {k}", pixels), (0.12, 0.12))
        a = np.linspace(-math.pi / 2, math.pi / 2, 17)
        shape = [(max(0.0365 * math.cos(v), 0.0005), 0.034 * math.sin(v)) for v in a]
        turn = 2 * math.pi * k / 4
        offset = (
            (0.0, 0.0, 0.105) if k == 4 else (0.052 * math.cos(turn), 0.052 * math.sin(turn), 0.066)
        )
        spot = tuple(m + o for m, o in zip(middle, offset, strict=True))
        lathe(f"fruit {k}", shape, mat, place(spot, (25 * k, 14 * k, 50 * k)), 32)


def chairs(lib: Library) -> None:
    """Four chairs, each pushed back and turned differently, with seats of different cloth."""
    spots = ((-0.42, 0.80, 8), (0.44, 0.74, -14), (-0.36, -0.76, 172), (0.52, -0.84, 196))
    grounds = ((0.34, 0.40, 0.44), (0.52, 0.26, 0.22), (0.62, 0.55, 0.40), (0.30, 0.36, 0.28))
    for k, ((x, y, turn), ground) in enumerate(zip(spots, grounds, strict=True)):
        frame = place((x, y, 0), (0, 0, turn))
        wood = lib.light if k % 2 else lib.dark
        pixels = tx.fabric(640, 640, 90 + k, ground, tx.WARM[1:] + tx.LEAVES[3:], 150)
        cloth = image_material(f"seat {k}", image(f"seat {k}", pixels), (0.42, 0.42), 0.001)
        box(f"seat {k}", (0.42, 0.4, 0.05), (0, 0, 0.45), cloth, frame, 0.02, 3)
        box(f"seat rail {k}", (0.4, 0.38, 0.05), (0, 0, 0.41), wood, frame, 0.004)
        for n, (sx, sy) in enumerate(((-1, -1), (1, -1), (-1, 1), (1, 1))):
            tall = 0.9 if sy > 0 else 0.42
            box(
                f"chair leg {k}{n}",
                (0.038, 0.038, tall),
                (sx * 0.19, sy * 0.18, tall / 2),
                wood,
                frame,
                0.005,
            )
        for n, z in enumerate((0.58, 0.72, 0.86)):
            box(f"chair slat {k}{n}", (0.36, 0.018, 0.07), (0, 0.18, z), wood, frame, 0.005)


def sideboard(lib: Library) -> None:
    """A sideboard on the south wall with drawers, doors, a runner and small things."""
    x, y = SIDEBOARD["centre"]
    top = SIDEBOARD["top"]
    frame = place((x, y, 0), (0, 0, 180))
    box(
        "sideboard body",
        (1.5, 0.42, top - 0.14),
        (0, 0, 0.1 + (top - 0.14) / 2),
        lib.dark,
        frame,
        0.005,
    )
    box("sideboard top", (1.58, 0.46, 0.04), (0, 0, top - 0.02), lib.table, frame, 0.008)
    for k in range(3):
        at = (k - 1) * 0.48
        box(f"drawer {k}", (0.44, 0.02, 0.16), (at, -0.215, top - 0.15), lib.light, frame, 0.008)
        box(f"cupboard {k}", (0.44, 0.02, 0.42), (at, -0.215, 0.37), lib.light, frame, 0.008)
        box(f"cupboard field {k}", (0.3, 0.02, 0.28), (at, -0.225, 0.37), lib.table, frame, 0.01)
        knob = ((0.001, 0), (0.012, 0), (0.008, 0.014), (0.017, 0.026), (0.001, 0.032))
        lathe(f"knob {k}", knob, lib.brass, frame @ place((at, -0.225, top - 0.15), (90, 0, 0)), 20)
    pixels = tx.fabric(1280, 380, 101, (0.36, 0.42, 0.46), tx.WARM[1:4] + tx.LEAVES[3:], 240)
    cloth = image_material("side runner", image("side runner", pixels), (1.2, 0.34))
    box("side runner", (1.2, 0.34, 0.003), (0, 0, top + 0.0015), cloth, frame, fit=True)
    pixels = tx.filigree(512, 512, 102, (0.78, 0.74, 0.66), (0.26, 0.34, 0.5))
    mat = image_material("urn", image("urn", pixels), (0.4, 0.4))
    shape = (
        (0.001, 0),
        (0.06, 0),
        (0.05, 0.02),
        (0.1, 0.13),
        (0.09, 0.2),
        (0.04, 0.26),
        (0.06, 0.3),
    )
    lathe("urn", shape, mat, frame @ place((-0.55, 0.02, top + 0.003)))
    for k in range(3):
        pixels = tx.fabric(300, 300, 103 + k, tx.WARM[2 * k % 5], tx.WARM[3:] + tx.LEAVES, 70)
        mat = image_material(f"box {k}", image(f"box {k}", pixels), (0.25, 0.25))
        size = 0.22 - 0.05 * k
        spot = frame @ place((0.53, 0.0, top + 0.003 + 0.08 * k), (0, 0, 10 - 17 * k))
        box(f"stack {k}", (size, size * 0.8, 0.08), (0, 0, 0.04), mat, spot, 0.003)


def armchair(lib: Library) -> None:
    """An upholstered armchair in the north-west corner, with a cushion."""
    frame = place((-1.98, 1.42, 0), (0, 0, 52))
    pixels = tx.fabric(1280, 1280, 111, (0.30, 0.40, 0.42), tx.WARM[1:4] + tx.LEAVES, 420)
    cloth = image_material("upholstery", image("upholstery", pixels), (1.1, 1.1), 0.001)
    box("armchair base", (0.7, 0.66, 0.26), (0, 0, 0.22), cloth, frame, 0.03, 3)
    box("armchair seat", (0.5, 0.56, 0.14), (0, -0.06, 0.41), cloth, frame, 0.05, 4)
    box("armchair back", (0.66, 0.16, 0.6), (0, 0.27, 0.6), cloth, frame, 0.06, 4)
    for k, sign in enumerate((-1, 1)):
        box(f"armchair arm {k}", (0.13, 0.66, 0.3), (sign * 0.33, 0, 0.44), cloth, frame, 0.05, 4)
    pixels = tx.fabric(512, 512, 113, (0.80, 0.70, 0.48), tx.WARM[:3] + tx.LEAVES[:2], 60)
    cloth = image_material("cushion", image("cushion", pixels), (0.4, 0.4))
    box(
        "cushion",
        (0.38, 0.12, 0.36),
        (0.03, 0.1, 0.64),
        cloth,
        frame @ place(turn=(-14, 0, 8)),
        0.05,
        4,
        True,
    )


def plant(lib: Library) -> None:
    """A leafy plant in a painted pot, north-east corner."""
    rng = np.random.default_rng(121)
    frame = place((2.12, 1.72, 0))
    pixels = tx.filigree(768, 512, 122, (0.66, 0.40, 0.28), (0.88, 0.78, 0.6))
    mat = image_material("pot", image("pot", pixels), (0.9, 0.6))
    lathe(
        "pot",
        (
            (0.001, 0),
            (0.14, 0),
            (0.2, 0.34),
            (0.21, 0.38),
            (0.18, 0.38),
            (0.17, 0.33),
            (0.001, 0.32),
        ),
        mat,
        frame,
    )
    green = tx.plaster(512, 256, 123, (0.46, 0.58, 0.30), (0.16, 0.30, 0.14))
    tx.leaf(green, (256, 128), 256, 118, 0.0, (0.36, 0.50, 0.24), 0.5)
    mat = image_material("leaf", image("leaf", green), (1.0, 1.0))
    v, u = np.mgrid[0:5, 0:14]
    u, v = u / 13.0, v / 4.0 - 0.5
    for k in range(46):
        length, wide = rng.uniform(0.35, 0.75), rng.uniform(0.07, 0.13)
        droop = rng.uniform(0.3, 1.1)
        rise = rng.uniform(0.7, 1.35)
        shape = np.sin(np.pi * u**0.8) * wide
        out = length * u * math.cos(rise) * (1 + 0.2 * u)
        up = length * (u * math.sin(rise) - 0.5 * droop * u * u) + 0.25 * wide * np.abs(v)
        points = np.stack([out, v * shape, up], -1)
        spot = frame @ place((0, 0, 0.33 + 0.5 * rng.random()), (0, 0, rng.uniform(0, 360)))
        leaf = sheet(f"leaf {k}", points, (1.0, 1.0), mat, spot)
        leaf.scale = (0.8, 0.8, 0.9)


def lamps(lib: Library) -> None:
    """A floor lamp and a pendant, and the light that they and the window stand for."""
    pixels = tx.fabric(1024, 384, 131, (0.88, 0.80, 0.62), tx.WARM[:2] + tx.LEAVES[:3], 160)
    mat = image_material("shade", image("shade", pixels), (1.3, 0.4), emission=0.12)
    frame = place((-2.2, -0.25, 0))
    lathe(
        "lamp foot",
        ((0.001, 0), (0.15, 0), (0.14, 0.025), (0.02, 0.04), (0.014, 1.3)),
        lib.brass,
        frame,
    )
    lathe("lamp shade", ((0.24, 1.22), (0.14, 1.58)), mat, frame)
    lathe(
        "pendant shade",
        ((0.2, 2.12), (0.19, 2.16), (0.08, 2.3), (0.01, 2.34), (0.006, 2.6)),
        mat,
        IDENTITY,
    )
    area("ceiling light", (0.0, 0.0, 2.42), (0, 0, 0), (4.2, 3.4), 92.0, (1.0, 0.95, 0.88))
    for k, sign in enumerate((-1, 1)):
        spot, turn = (sign * 1.2, 0.0, 2.2), (0, -sign * 62, 0)
        area(f"fill light {k}", spot, turn, (0.5, 3.0), 22.0, (1.0, 0.96, 0.9))
    area("window light", (-0.55, 1.95, 1.6), (-80, 0, 0), (1.5, 1.2), 36.0, (0.92, 0.96, 1.0))


def area(
    name: str,
    location: tuple[float, float, float],
    turn: tuple[float, float, float],
    size: tuple[float, float],
    power: float,
    colour: tuple[float, float, float],
) -> None:
    """A rectangular light that no camera sees; it shines along its local -Z."""
    data = bpy.data.lights.new(name, "AREA")
    data.shape = "RECTANGLE"
    data.size, data.size_y = size
    data.energy, data.color = power, colour
    lamp = bpy.data.objects.new(name, data)
    lamp.matrix_world = place(location, turn)
    lamp.visible_camera = False
    bpy.context.scene.collection.objects.link(lamp)
