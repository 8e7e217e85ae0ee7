# SPDX-License-Identifier: GPL-3.0-or-later
"""The three objects that are worth a box: a carved vase, a printed tin and a carved clock.

Every part carries the custom property `roi`; the bounds of an object are those of its parts.
"""

from __future__ import annotations

import math

import bpy
import numpy as np
import textures as tx
from build import (
    attribute_material,
    box,
    colour_points,
    grid_quads,
    image,
    image_material,
    lathe,
    mesh_object,
    panel,
    place,
    plain_material,
    sheet,
    text,
)
from mathutils import Matrix, Vector
from room import SIDEBOARD, TABLE_TOP, Library

ROMAN = ["XII", "I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X", "XI"]


def build_objects(lib: Library) -> None:
    """All objects that get a box."""
    vase(place((-0.44, 0.06, TABLE_TOP + 0.003)) @ Matrix.Scale(0.86, 4))
    tin(lib, place((0.44, -0.03, TABLE_TOP + 0.003), (0, 0, 24)))
    x, y = SIDEBOARD["centre"]
    spot = place((x, y + 0.05, SIDEBOARD["top"] + 0.003), (0, 0, 180))
    clock(lib, spot @ Matrix.Scale(0.82, 4))


# --- vase ---------------------------------------------------------------------------------------


def vase(frame: Matrix, rows: int = 820, cols: int = 1320, height: float = 0.31) -> None:
    """A vase whose carving is real geometry: gadroons, beads, rosettes, meander, twisted flutes."""
    t = np.linspace(0.0, 1.0, rows)[:, None]
    angle = np.linspace(0.0, 2 * np.pi, cols, endpoint=False)[None, :]
    depth, colour = _carving(t, angle)
    radius = _smooth_profile(t) + depth
    z = np.broadcast_to(t * height, radius.shape)
    outer = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1).reshape(-1, 3)
    mat = attribute_material("vase")
    body = mesh_object("vase", outer, grid_quads(rows, cols, True), None, mat, frame, True, "vase")
    colour_points(body, colour)
    dark = plain_material("vase inside", (0.20, 0.15, 0.12))
    lip = float(radius[-1].mean())
    inner = (
        (lip, height),
        (lip - 0.006, height + 0.001),
        (0.034, 0.8 * height),
        (0.001, 0.7 * height),
    )
    lathe("vase inside", inner, dark, frame, 96, "vase")
    lathe(
        "vase foot", ((0.001, 0.0005), (float(radius[0].mean()), 0.0005)), dark, frame, 48, "vase"
    )


def _smooth_profile(t: np.ndarray) -> np.ndarray:
    stops = np.array([0.0, 0.05, 0.1, 0.2, 0.32, 0.44, 0.56, 0.68, 0.78, 0.88, 0.96, 1.0])
    sizes = np.array([5.2, 5.2, 4.5, 6.4, 8.1, 8.9, 8.3, 6.3, 4.4, 4.0, 4.9, 5.5]) / 100.0
    fine = np.linspace(0.0, 1.0, 400)
    values = np.interp(fine, stops, sizes)
    kernel = np.hanning(31)
    padded = np.pad(values, 15, mode="edge")
    values = np.convolve(padded, kernel / kernel.sum(), mode="valid")
    return np.interp(t, fine, values)


def _carving(t: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height of the relief in metres and colour, over rows (t) and columns (angle)."""
    shape = (t.shape[0], angle.shape[1])
    rng = np.random.default_rng(201)
    depth = np.zeros(shape)
    clay = tx.ramp(tx.fbm(shape, (6, 9), 7, rng, 0.6), ((0.72, 0.58, 0.42), (0.90, 0.82, 0.68)))
    colour = clay.copy()
    full = np.broadcast_to(t, shape)

    def band(low: float, high: float) -> np.ndarray:
        return (full >= low) & (full < high)

    def lay(mask: np.ndarray, relief: np.ndarray, paint: tx.Colour | None, amount: float) -> None:
        depth[mask] = relief[mask]
        if paint is not None:
            colour[mask] += amount * (np.asarray(paint) - colour[mask])

    gadroon = 0.0034 * np.abs(np.sin(13 * angle + 0 * t)) - 0.001
    lay(band(0.09, 0.20), gadroon, (0.24, 0.34, 0.46), 0.75)
    colour[band(0.09, 0.20) & (gadroon > 0.0012)] = (0.74, 0.66, 0.48)
    for low, count, paint in (
        (0.205, 60, tx.WARM[1]),
        (0.575, 76, tx.WARM[0]),
        (0.70, 52, tx.WARM[1]),
    ):
        u = (angle / (2 * np.pi) * count) % 1.0 - 0.5
        v = (t - low - 0.014) / 0.028
        bead = np.sqrt(np.clip(0.25 - u * u - v * v, 0.0, None)) * 0.0075
        mask = band(low, low + 0.028)
        lay(mask, bead - 0.001, paint, 0.6)
        colour[mask & (bead < 1e-5)] = (0.20, 0.14, 0.10)
    relief, paint = _rosettes(t, angle, rng)
    mask = band(0.235, 0.575)
    depth[mask], colour[mask] = relief[mask], paint[mask]
    relief = _meander(t, angle)
    lay(band(0.607, 0.70), relief, (0.56, 0.24, 0.16), 0.7)
    colour[band(0.607, 0.70) & (relief > 0.0005)] = (0.90, 0.84, 0.70)
    flutes = 0.0020 * np.sin(21 * angle + 34 * t)
    lay(band(0.73, 0.915), flutes, (0.26, 0.36, 0.34), 0.7)
    colour[band(0.73, 0.915) & (flutes > 0.0006)] = (0.80, 0.72, 0.54)
    rope = 0.0024 * np.abs(np.sin(30 * angle + 120 * t))
    lay(band(0.93, 0.985), rope, (0.72, 0.54, 0.26), 0.6)
    grain = tx.fbm(shape, (110, 170), 2, rng)
    depth += 0.0005 * (grain - 0.5)
    colour *= (0.80 + 0.3 * grain)[..., None]
    hollow = np.clip((depth + 0.0025) / 0.005, 0.0, 1.0)
    return depth, np.clip(colour * (0.62 + 0.42 * hollow)[..., None], 0.0, 1.0)


def _rosettes(
    t: np.ndarray, angle: np.ndarray, rng: np.random.Generator, around: int = 14, rows: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """A lattice of lozenges, each with a flower of its own."""
    u = angle / (2 * np.pi) * around + 0 * t
    v = (t - 0.235) / 0.34 * rows + 0 * angle
    a, b = u + v, u - v
    ia, ib = np.floor(a).astype(int), np.floor(b).astype(int)
    fa, fb = a - ia - 0.5, b - ib - 0.5
    cell = (ia * 37 + ib * 101) % 97
    petals = rng.integers(5, 11, 97)[cell]
    turn = rng.uniform(0, 6.28, 97)[cell]
    tones = np.array(
        [tx.WARM[0], (0.20, 0.30, 0.52), (0.76, 0.52, 0.20), (0.30, 0.44, 0.32), tx.WARM[5]]
    )
    tone = tones[rng.integers(0, len(tones), 97)[cell]]
    radius, phi = np.hypot(fa, fb), np.arctan2(fb, fa) + turn
    edge = 0.26 + 0.12 * np.cos(petals * phi)
    flower = np.clip((edge - radius) / 0.1, 0.0, 1.0)
    veins = 0.5 + 0.5 * np.cos(petals * 5 * phi)
    heart = np.clip((0.11 - radius) / 0.04, 0.0, 1.0)
    lattice = np.clip((np.maximum(np.abs(fa), np.abs(fb)) - 0.43) / 0.03, 0.0, 1.0)
    relief = -0.0022 + 0.0034 * flower + 0.0012 * heart + 0.0036 * lattice + 0.0007 * veins * flower
    paint = tx.mix((0.24, 0.17, 0.13), (0.86, 0.78, 0.62), lattice.astype(np.float32))
    shaded = tone * (0.75 + 0.5 * veins)[..., None]
    paint += flower[..., None] * (shaded - paint)
    paint += heart[..., None] * (np.array([0.90, 0.74, 0.34]) - paint)
    return relief, paint


def _meander(t: np.ndarray, angle: np.ndarray, count: int = 30) -> np.ndarray:
    """A Greek key round the shoulder."""
    key = np.array(
        [
            [1, 1, 1, 1, 1, 1, 1, 0],
            [1, 0, 0, 0, 0, 0, 1, 0],
            [1, 0, 1, 1, 1, 0, 1, 0],
            [1, 0, 1, 0, 1, 0, 1, 0],
            [1, 0, 1, 0, 0, 0, 1, 0],
            [1, 0, 1, 1, 1, 1, 1, 1],
        ]
    )
    u = ((angle / (2 * np.pi) * count) % 1.0 * 8).astype(int) + 0 * t.astype(int)
    v = np.clip((t - 0.607) / 0.093 * 8 - 1, -1, 6).astype(int) + 0 * u
    inside = (v >= 0) & (v < 6) & (t > 0.62) & (t < 0.687)
    return np.where(inside, key[np.clip(5 - v, 0, 5), u] * 0.0022 - 0.0008, -0.0008)


# --- tin ----------------------------------------------------------------------------------------

SIDES: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = (
    (
        "front",
        (
            ("MERIDIAN", 0.023),
            ("SPICE & TEA", 0.016),
            ("blended by hand", 0.0095),
            ("No. 27", 0.027),
            ("CARDAMOM  CLOVE", 0.0085),
            ("250 g", 0.013),
        ),
    ),
    (
        "right",
        (
            ("HARVEST", 0.012),
            ("1  Assam  40", 0.009),
            ("2  Keemun  25", 0.009),
            ("3  Nilgiri  15", 0.009),
            ("4  Ginger  12", 0.009),
            ("5  Orange  8", 0.009),
            ("LOT 4581", 0.012),
        ),
    ),
    (
        "back",
        (
            ("HOW TO BREW", 0.014),
            ("Warm the pot. One spoon", 0.0078),
            ("for each cup, one more", 0.0078),
            ("for luck. Water just off", 0.0078),
            ("the boil, four minutes.", 0.0078),
            ("Stir once, and pour.", 0.0078),
            ("KEEP DRY", 0.017),
        ),
    ),
    (
        "left",
        (("FINE", 0.017), ("WHOLE", 0.015), ("LEAF", 0.017), ("est.", 0.010), ("1884", 0.022)),
    ),
)


def tin(
    lib: Library, frame: Matrix, size: tuple[float, float, float] = (0.15, 0.12, 0.185)
) -> None:
    """A tea tin with four different printed sides, twisted edges and a carved lid."""
    w, d, h = size
    ground = image("tin ground", tx.filigree(900, 900, 211, (0.14, 0.24, 0.22), (0.82, 0.66, 0.32)))
    green = image_material("tin ground", ground, (0.16, 0.16))
    box("tin body", (w - 0.002, d - 0.002, h), (0, 0, h / 2), green, frame, fit=True, roi="tin")
    widths = (w, d, w, d)
    for k, (side, lines) in enumerate(SIDES):
        wide = widths[k]
        out = (d, w, d, w)[k] / 2
        facing = frame @ place(turn=(0, 0, 90 * k)) @ place((0, -out, h / 2))
        pixels = tx.label(int(wide * 6400), int(h * 5800), 212 + k)
        mat = image_material(
            f"tin {side}", image(f"tin {side}", pixels), (wide - 0.018, h - 0.02), 0.75
        )
        panel(f"tin {side}", (wide - 0.018, h - 0.02), mat, facing @ place((0, -0.0004, 0)), "tin")
        _lines(f"tin {side}", lines, wide - 0.056, h - 0.066, facing, lib)
    for k, (sx, sy) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
        corner = frame @ place((sx * (w / 2 - 0.001), sy * (d / 2 - 0.001), 0))
        profile = [(0.0045, z) for z in np.linspace(0.0, h, 90)]
        lathe(f"tin edge {k}", profile, lib.gold, corner, 36, "tin", 0.3, 3, 420.0)
    lid = image("tin lid", tx.filigree(700, 700, 219, (0.50, 0.16, 0.13), (0.90, 0.76, 0.42)))
    red = image_material("tin lid", lid, (0.16, 0.16))
    steps = ((0.006, 0.010), (0.012, 0.006), (-0.012, 0.008))
    z = h
    for k, (grow, tall) in enumerate(steps):
        size_k = (w + grow, d + grow, tall)
        box(f"tin lid {k}", size_k, (0, 0, z + tall / 2), red, frame, 0.0015, fit=True, roi="tin")
        z += tall
    top = frame @ place((0, -0.042, z + 0.0003), (-90, 0, 0))
    text("tin lid words", "TURN TO OPEN", 0.013, lib.gold, top, 0.0012, 0.1, roi="tin")
    top = frame @ place((0, 0.042, z + 0.0003), (-90, 0, 0))
    text("tin lid more", "MERIDIAN 27", 0.013, lib.gold, top, 0.0012, 0.1, roi="tin")
    knob = (
        (0.016, 0),
        (0.011, 0.006),
        (0.012, 0.010),
        (0.02, 0.017),
        (0.021, 0.022),
        (0.014, 0.028),
        (0.001, 0.03),
    )
    profile = _resample(knob, 60)
    lathe("tin knob", profile, lib.gold, frame @ place((0, 0, z)), 120, "tin", 0.08, 14, 60.0)


def _resample(profile: tuple[tuple[float, float], ...], count: int) -> list[tuple[float, float]]:
    values = np.asarray(profile)
    at = np.linspace(0, len(values) - 1, count)
    return [
        (
            float(np.interp(x, np.arange(len(values)), values[:, 0])),
            float(np.interp(x, np.arange(len(values)), values[:, 1])),
        )
        for x in at
    ]


def _lines(
    name: str,
    lines: tuple[tuple[str, float], ...],
    wide: float,
    tall: float,
    facing: Matrix,
    lib: Library,
) -> None:
    """Lines of print spread over a label, big ones in red."""
    red = bpy.data.materials.get("red print") or plain_material("red print", (0.55, 0.12, 0.10))
    total = sum(height for _, height in lines)
    gap = (tall - total) / max(len(lines) - 1, 1)
    z = tall / 2
    for k, (line, height) in enumerate(lines):
        z -= height / 2
        spot = facing @ place((0, -0.0008, z))
        ink = red if height >= 0.0165 else lib.ink
        text(f"{name} line {k}", line, height * 1.25, ink, spot, 0.0002, wide, roi="tin")
        z -= height / 2 + gap


# --- clock --------------------------------------------------------------------------------------


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
                _resample(column, 160),
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
                f"clock finial {k}{n}", _resample(finial, 40), lib.gold, spot, 40, "clock", 0.06, 9
            )
    _pediment(gilt, lib, frame)


def _dial(lib: Library, frame: Matrix, size: float) -> None:
    pixels = tx.dial(1200, 231)
    corner = tx.filigree(1200, 1200, 232, (0.30, 0.16, 0.10), (0.86, 0.68, 0.34))
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


def bounds() -> dict[str, tuple[list[float], list[float]]]:
    """World bounds (min, max) of every boxed object, from the points of its parts."""
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    found: dict[str, list[np.ndarray]] = {}
    for obj in bpy.context.scene.objects:
        if "roi" not in obj:
            continue
        mesh = obj.evaluated_get(graph).data
        points = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.vertices.foreach_get("co", points)
        matrix = np.array(obj.matrix_world)
        world = points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
        found.setdefault(obj["roi"], []).extend((world.min(0), world.max(0)))
    return {
        name: (np.min(spots, 0).tolist(), np.max(spots, 0).tolist())
        for name, spots in found.items()
    }
