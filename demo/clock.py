# SPDX-License-Identifier: GPL-3.0-or-later
"""The carved clock, one of the three objects that get a box."""

from __future__ import annotations

import math

import bpy
import numpy as np
import prints
import textures as tx
from build import (
    attribute_material,
    box,
    colour_points,
    image,
    image_material,
    lathe,
    mesh_object,
    panel,
    place,
    plain_material,
    resample,
    sheet,
    text,
)
from materials import Library
from mathutils import Matrix, Vector

ROMAN = ["XII", "I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X", "XI"]


def clock(lib: Library, frame: Matrix) -> None:
    """A mantel clock: numerals, hands, print on the dial, carved panels, turned columns."""
    box("clock base", (0.31, 0.15, 0.03), (0, 0, 0.015), lib.dark, frame, 0.004, roi="clock")
    box("clock plinth", (0.28, 0.13, 0.04), (0, 0, 0.05), lib.table, frame, 0.004, roi="clock")
    box("clock case", (0.22, 0.10, 0.23), (0, 0, 0.185), lib.dark, frame, 0.003, roi="clock")
    box("clock cornice", (0.29, 0.14, 0.018), (0, 0, 0.309), lib.table, frame, 0.004, roi="clock")
    box("clock top", (0.26, 0.12, 0.012), (0, 0, 0.324), lib.dark, frame, 0.003, roi="clock")
    plaque = image("plaque", tx.plaster(512, 96, 221, (0.86, 0.72, 0.42), (0.62, 0.46, 0.22)))
    mat = image_material("plaque", plaque, (0.2, 0.03))
    box(
        "clock plaque",
        (0.2, 0.004, 0.03),
        (0, -0.0655, 0.05),
        mat,
        frame,
        0.001,
        fit=True,
        roi="clock",
    )
    words = frame @ place((0, -0.068, 0.05))
    text("clock plaque words", "TIME FLIES  1884", 0.021, lib.ink, words, 0.0004, 0.18, roi="clock")
    _dial(lib, frame @ place((0, -0.0505, 0.185)), 0.2)
    gilt = attribute_material("gilt")
    for k, side in enumerate((-1, 1)):
        facing = frame @ place((side * 0.1105, 0, 0.185), (0, 0, side * 90))
        relief_panel(f"clock side {k}", (0.09, 0.21), 222 + k, gilt, facing, "clock")
        for n, y in enumerate((-0.052, 0.052)):
            spot = frame @ place((side * 0.124, y, 0.07))
            column = (
                (0.0115, 0.0),
                (0.0115, 0.006),
                (0.008, 0.012),
                (0.0095, 0.06),
                (0.008, 0.212),
                (0.0115, 0.219),
                (0.0115, 0.23),
            )
            lathe(
                f"clock column {k}{n}",
                resample(column, 160),
                lib.light,
                spot,
                60,
                "clock",
                0.16,
                5,
                260.0,
            )
            finial = (
                (0.009, 0),
                (0.005, 0.006),
                (0.012, 0.016),
                (0.010, 0.026),
                (0.003, 0.034),
                (0.001, 0.044),
            )
            spot = frame @ place((side * 0.118, y * 0.9, 0.318))
            lathe(
                f"clock finial {k}{n}", resample(finial, 40), lib.gold, spot, 40, "clock", 0.06, 9
            )
    _pediment(gilt, lib, frame)


def _dial(lib: Library, frame: Matrix, size: float) -> None:
    pixels = prints.dial(1200, 231)
    corner = prints.filigree(1200, 1200, 232, (0.30, 0.16, 0.10), (0.86, 0.68, 0.34))
    y, x = (np.mgrid[0:1200, 0:1200] + 0.5) / 600.0 - 1.0
    outside = np.hypot(x, y) > 0.93
    pixels[outside] = corner[outside]
    mat = image_material("dial", image("dial", pixels), (size, size))
    panel("clock dial", (size, size), mat, frame, "clock")
    half = size / 2
    for hour, numeral in enumerate(ROMAN):
        a = math.radians(30 * hour)
        spot = place(
            (0.645 * half * math.sin(a), -0.0006, 0.645 * half * math.cos(a)), (0, 30 * hour, 0)
        )
        text(
            f"clock hour {hour}",
            numeral,
            0.030,
            lib.ink,
            frame @ spot,
            0.0004,
            0.03,
            roi="clock",
            spacing=0.95,
        )
    cream = plain_material("dial tag", (0.90, 0.86, 0.74))
    for k, (words, z, height) in enumerate(
        (("MERIDIAN", 0.021, 0.0105), ("No. 4581", -0.024, 0.0095))
    ):
        box(
            f"clock tag {k}",
            (0.056, 0.001, 0.013),
            (0, -0.0006, z),
            cream,
            frame,
            fit=True,
            roi="clock",
        )
        text(
            f"clock name {k}",
            words,
            height,
            lib.ink,
            frame @ place((0, -0.0014, z)),
            0.0003,
            0.05,
            roi="clock",
        )
    steel = plain_material("hands", (0.10, 0.12, 0.22))
    for k, (length, wide, turn) in enumerate(((0.05, 0.006, 304.0), (0.076, 0.0042, 52.0))):
        hand = frame @ place((0, -0.004 - 0.002 * k, 0), (0, turn, 0))
        outline = [
            (-0.35, 0),
            (-0.35, 0.7),
            (-1, 0.74),
            (0, 1),
            (1, 0.74),
            (0.35, 0.7),
            (0.35, 0),
            (0, -0.18),
        ]
        points = np.array([[wide * x, 0.0, length * z] for x, z in outline])
        mesh_object(
            f"clock hand {k}",
            points,
            [list(range(len(points)))[::-1]],
            None,
            steel,
            hand,
            False,
            "clock",
        )
    pin = ((0.005, 0), (0.005, 0.006), (0.001, 0.009))
    lathe("clock pin", pin, lib.gold, frame @ place(turn=(90, 0, 0)), 24, "clock")
    ring = _ring(0.093, 0.0045, 300, 24)
    mesh_object("clock bezel", ring, _ring_quads(300, 24), None, lib.gold, frame, True, "clock")


def _ring(radius: float, thick: float, around: int, across: int) -> np.ndarray:
    """A bezel with a rope pattern, in the XZ plane."""
    a = np.linspace(0, 2 * np.pi, around, endpoint=False)[:, None]
    b = np.linspace(0, 2 * np.pi, across, endpoint=False)[None, :]
    r = thick * (1.0 + 0.22 * np.cos(48 * a + 2 * b))
    out = radius + r * np.cos(b)
    return np.stack([out * np.cos(a), r * np.sin(b), out * np.sin(a)], -1).reshape(-1, 3)


def _ring_quads(around: int, across: int) -> np.ndarray:
    i, j = np.mgrid[0:around, 0:across]
    n, k = (i + 1) % around, (j + 1) % across
    quads = np.stack([i * across + j, i * across + k, n * across + k, n * across + j], -1)
    return quads.reshape(-1, 4)


def _pediment(gilt: bpy.types.Material, lib: Library, frame: Matrix) -> None:
    """The carved top: an arched panel with leaves, and a boss with a letter."""
    rows, cols = 220, 520
    height, colour = _relief(cols, rows, 225)
    u = np.linspace(-1.0, 1.0, cols)[None, :]
    v = np.linspace(0.0, 1.0, rows)[:, None]
    arch = 0.016 + 0.05 * np.cos(0.5 * np.pi * u) ** 0.8
    x, z = u * 0.115 + 0 * v, v * arch
    for k, turn in enumerate((0, 180)):
        points = np.stack([x, -0.003 * height + 0 * x, z], -1)
        facing = frame @ place((0, 0, 0.33), (0, 0, turn)) @ place((0, -0.018, 0))
        obj = sheet(f"clock pediment {k}", points, (1, 1), gilt, facing, "clock")
        colour_points(obj, colour)
    rim = np.stack([np.stack([x[-1], np.full(cols, y), z[-1]], -1) for y in (-0.018, 0.018)])
    sheet(
        "clock arch",
        rim,
        (0.3, 0.036),
        lib.dark,
        frame @ Matrix.Translation(Vector((0, 0, 0.33))),
        "clock",
    )
    boss = ((0.018, 0), (0.018, 0.003), (0.015, 0.004), (0.014, 0.003), (0.001, 0.003))
    at = frame @ place((0, -0.019, 0.36))
    lathe("clock boss", boss, lib.gold, at @ place(turn=(90, 0, 0)), 72, "clock", 0.03, 24)
    text("clock letter", "M", 0.022, lib.ink, at @ place((0, -0.0034, 0)), 0.0006, roi="clock")


def _relief(cols: int, rows: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Carved foliage: height in 0..1 and the colour of worn gilding."""
    rng = np.random.default_rng(seed)
    carved = np.zeros((rows, cols, 3), np.float32)
    short = min(rows, cols)
    for k, spot in enumerate(tx.jittered(46, cols, rows, rng)):
        tone = rng.uniform(0.55, 1.0)
        size = short * rng.uniform(0.10, 0.2)
        if k % 4 == 0:
            tx.flower(
                carved,
                spot,
                size,
                int(rng.integers(5, 10)),
                rng.uniform(0, 6),
                (tone,) * 3,
                (1, 1, 1),
            )
        else:
            tx.leaf(carved, spot, size, size * 0.36, rng.uniform(0, 6.28), (tone,) * 3, 0.95)
    y, x = np.mgrid[0:rows, 0:cols]
    edge = np.minimum(np.minimum(x, cols - 1 - x), np.minimum(y, rows - 1 - y)) / short
    height = np.where(edge < 0.06, 0.9 + 0.1 * np.sin((x + y) * 0.5), carved[..., 0])
    worn = tx.fbm((rows, cols), (rows / 12, cols / 12), 3, rng)
    colour = tx.ramp(
        np.clip(height + 0.2 * (worn - 0.5), 0, 1),
        ((0.12, 0.07, 0.05), (0.38, 0.22, 0.12), (0.72, 0.54, 0.26), (0.93, 0.82, 0.55)),
    )
    return height, colour


def relief_panel(
    name: str,
    size: tuple[float, float],
    seed: int,
    material: bpy.types.Material,
    frame: Matrix,
    roi: str,
) -> None:
    """A carved panel in the local XZ plane, facing -Y, 3 mm deep."""
    rows, cols = int(size[1] * 2600), int(size[0] * 2600)
    height, colour = _relief(cols, rows, seed)
    x = np.broadcast_to(np.linspace(-size[0] / 2, size[0] / 2, cols)[None, :], height.shape)
    z = np.broadcast_to(np.linspace(-size[1] / 2, size[1] / 2, rows)[:, None], height.shape)
    obj = sheet(name, np.stack([x, -0.003 * height, z], -1), size, material, frame, roi)
    colour_points(obj, colour)
