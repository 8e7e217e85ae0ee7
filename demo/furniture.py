# SPDX-License-Identifier: GPL-3.0-or-later
"""The furniture of the demo room, and what lies on it."""

from __future__ import annotations

import math

import numpy as np
import prints
import textures as tx
from build import box, image, image_material, lathe, place, sheet, text
from materials import Library
from measures import SIDEBOARD, TABLE_TOP


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
    paper = image_material("paper", image("paper", prints.newsprint(840, 1100, 72)), (0.29, 0.38))
    y, x = np.mgrid[0:12, 0:12]
    bend = TABLE_TOP + 0.004 + 0.004 * np.sin(x / 3.0) * np.cos(y / 4.0) + 0.004
    points = np.stack([(x / 11 - 0.5) * 0.29, (y / 11 - 0.5) * 0.38, bend], -1)
    sheet("newspaper", points, (0.29, 0.38), paper, place((0.02, -0.2, 0), (0, 0, -24)))
    fruit_bowl(lib)
    cloth = image("covers", prints.filigree(512, 512, 73, (0.80, 0.76, 0.7), (0.5, 0.36, 0.2)))
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
    pixels = prints.filigree(512, 512, 102, (0.78, 0.74, 0.66), (0.26, 0.34, 0.5))
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
    pixels = prints.filigree(768, 512, 122, (0.66, 0.40, 0.28), (0.88, 0.78, 0.6))
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
