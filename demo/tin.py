# SPDX-License-Identifier: GPL-3.0-or-later
"""The printed tin, one of the three objects that get a box."""

from __future__ import annotations

import bpy
import numpy as np
import prints
from build import box, image, image_material, lathe, panel, place, plain_material, resample, text
from materials import Library
from mathutils import Matrix

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
    ground = image(
        "tin ground", prints.filigree(900, 900, 211, (0.14, 0.24, 0.22), (0.82, 0.66, 0.32))
    )
    green = image_material("tin ground", ground, (0.16, 0.16))
    box("tin body", (w - 0.002, d - 0.002, h), (0, 0, h / 2), green, frame, fit=True, roi="tin")
    widths = (w, d, w, d)
    for k, (side, lines) in enumerate(SIDES):
        wide = widths[k]
        out = (d, w, d, w)[k] / 2
        facing = frame @ place(turn=(0, 0, 90 * k)) @ place((0, -out, h / 2))
        pixels = prints.label(int(wide * 6400), int(h * 5800), 212 + k)
        mat = image_material(
            f"tin {side}", image(f"tin {side}", pixels), (wide - 0.018, h - 0.02), 0.75
        )
        panel(f"tin {side}", (wide - 0.018, h - 0.02), mat, facing @ place((0, -0.0004, 0)), "tin")
        _lines(f"tin {side}", lines, wide - 0.056, h - 0.066, facing, lib)
    for k, (sx, sy) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
        corner = frame @ place((sx * (w / 2 - 0.001), sy * (d / 2 - 0.001), 0))
        profile = [(0.0045, z) for z in np.linspace(0.0, h, 90)]
        lathe(f"tin edge {k}", profile, lib.gold, corner, 36, "tin", 0.3, 3, 420.0)
    lid = image("tin lid", prints.filigree(700, 700, 219, (0.50, 0.16, 0.13), (0.90, 0.76, 0.42)))
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
    profile = resample(knob, 60)
    lathe("tin knob", profile, lib.gold, frame @ place((0, 0, z)), 120, "tin", 0.08, 14, 60.0)


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
