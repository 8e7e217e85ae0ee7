# SPDX-License-Identifier: GPL-3.0-or-later
"""The carved vase, one of the three objects that get a box."""

from __future__ import annotations

import numpy as np
import textures as tx
from build import attribute_material, colour_points, grid_quads, lathe, mesh_object, plain_material
from mathutils import Matrix


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
    """A lattice of lozenges, each with a different flower."""
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
