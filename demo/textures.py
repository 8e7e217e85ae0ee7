# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of the demo room, computed with numpy and handed to Blender as packed images.

Every function returns an array (height, width, 3) of sRGB values in 0..1, row 0 at the bottom,
which is Blender's order. Nothing here tiles exactly: structure from motion is confused by
surfaces that repeat, so motifs are scattered and varied instead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

Colour = tuple[float, float, float]

LEAVES: tuple[Colour, ...] = (
    (0.29, 0.42, 0.36),
    (0.40, 0.52, 0.42),
    (0.24, 0.36, 0.44),
    (0.55, 0.57, 0.40),
    (0.70, 0.48, 0.36),
)
WARM: tuple[Colour, ...] = (
    (0.62, 0.20, 0.16),
    (0.80, 0.55, 0.22),
    (0.20, 0.26, 0.42),
    (0.88, 0.80, 0.64),
    (0.33, 0.42, 0.34),
    (0.50, 0.16, 0.24),
)


def fbm(
    shape: tuple[int, int],
    cells: tuple[float, float],
    octaves: int,
    rng: np.random.Generator,
    gain: float = 0.5,
) -> np.ndarray:
    """Value noise summed over octaves, scaled to 0..1; `cells` is (rows, columns) of the first."""
    total = np.zeros(shape, np.float32)
    weight = 1.0
    for octave in range(octaves):
        rows = min(max(int(cells[0] * 2**octave), 1), shape[0])
        cols = min(max(int(cells[1] * 2**octave), 1), shape[1])
        grid = rng.random((rows + 2, cols + 2), dtype=np.float32)
        total += weight * _upsample(grid, shape, rows, cols)
        weight *= gain
    low, high = np.percentile(total, (0.5, 99.5))
    return np.clip((total - low) / max(high - low, 1e-6), 0.0, 1.0)


def _upsample(grid: np.ndarray, shape: tuple[int, int], rows: int, cols: int) -> np.ndarray:
    def axis(size: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        place = np.linspace(0.0, count, size, endpoint=False)
        first = place.astype(int)
        part = place - first
        return first, (part * part * (3.0 - 2.0 * part)).astype(np.float32)

    y, fy = axis(shape[0], rows)
    x, fx = axis(shape[1], cols)
    lines = grid[y] * (1.0 - fy[:, None]) + grid[y + 1] * fy[:, None]
    return lines[:, x] * (1.0 - fx) + lines[:, x + 1] * fx


def mix(a: np.ndarray | Colour, b: np.ndarray | Colour, t: np.ndarray) -> np.ndarray:
    """Blend two colours (or colour arrays) by the array t."""
    t = t[..., None]
    return (np.asarray(a, np.float32) * (1.0 - t) + np.asarray(b, np.float32) * t).astype(
        np.float32
    )


def ramp(values: np.ndarray, colours: Sequence[Colour]) -> np.ndarray:
    """Map values in 0..1 through evenly spaced colours."""
    stops = np.linspace(0.0, 1.0, len(colours))
    table = np.asarray(colours, np.float32)
    return np.stack([np.interp(values, stops, table[:, c]) for c in range(3)], -1).astype(
        np.float32
    )


def leaf(
    img: np.ndarray,
    place: tuple[float, float],
    length: float,
    width: float,
    angle: float,
    colour: Colour,
    alpha: float = 0.85,
) -> None:
    """Paint one leaf with a midrib and veins; sizes in pixels."""
    height, full = img.shape[:2]
    reach = int(length) + 2
    x0, x1 = max(int(place[0]) - reach, 0), min(int(place[0]) + reach + 1, full)
    y0, y1 = max(int(place[1]) - reach, 0), min(int(place[1]) + reach + 1, height)
    if x0 >= x1 or y0 >= y1:
        return
    dy, dx = np.mgrid[y0:y1, x0:x1].astype(np.float32)
    dx -= place[0]
    dy -= place[1]
    u = (math.cos(angle) * dx + math.sin(angle) * dy) / length
    v = (-math.sin(angle) * dx + math.cos(angle) * dy) / width
    edge = 1.0 - u * u
    mask = np.clip((edge - np.abs(v)) * width * 0.7, 0.0, 1.0) * (np.abs(u) < 1.0)
    veins = 0.88 + 0.12 * np.sign(np.sin((u + 0.5 * np.abs(v)) * 22.0))
    shade = veins * np.where(np.abs(v) < 0.1, 1.25, np.where(v > 0, 1.0, 0.82))
    patch = img[y0:y1, x0:x1]
    paint = np.clip(np.asarray(colour, np.float32) * shade[..., None], 0.0, 1.0)
    patch += (alpha * mask)[..., None] * (paint - patch)


def flower(
    img: np.ndarray,
    place: tuple[float, float],
    size: float,
    petals: int,
    angle: float,
    colour: Colour,
    heart: Colour = (0.86, 0.66, 0.25),
    alpha: float = 0.95,
) -> None:
    """Paint one flower seen from above; size (radius) in pixels."""
    for k in range(petals):
        turn = angle + 2.0 * math.pi * k / petals
        middle = (
            place[0] + 0.55 * size * math.cos(turn),
            place[1] + 0.55 * size * math.sin(turn),
        )
        leaf(img, middle, 0.5 * size, 1.2 * size / petals, turn, colour, alpha)
    leaf(img, place, 0.24 * size, 0.24 * size, angle, heart, alpha)


def scatter(
    img: np.ndarray,
    count: int,
    size: tuple[float, float],
    colours: Sequence[Colour],
    seed: int,
    alpha: float = 0.85,
) -> np.ndarray:
    """Scatter twigs, leaves and flowers over an image at jittered places."""
    rng = np.random.default_rng(seed)
    height, width = img.shape[:2]
    for place in jittered(count, width, height, rng):
        extent = rng.uniform(*size)
        colour = colours[rng.integers(len(colours))]
        angle = rng.uniform(0.0, 2.0 * math.pi)
        if rng.random() < 0.35:
            flower(img, place, extent, int(rng.integers(5, 10)), angle, colour, alpha=alpha)
            continue
        c, s = math.cos(angle), math.sin(angle)
        leaf(img, place, 1.1 * extent, 0.06 * extent, angle, colour, alpha)
        for k in range(int(rng.integers(4, 8))):
            side = 1 if k % 2 else -1
            along, off = (0.36 * k - 0.8) * extent, 0.3 * side * extent
            spot = (place[0] + along * c - off * s, place[1] + along * s + off * c)
            turn = angle + side * (0.75 + rng.normal(0.0, 0.15))
            leaf(img, spot, 0.4 * extent, 0.16 * extent, turn, colour, alpha)
    return img


def jittered(
    count: int, width: int, height: int, rng: np.random.Generator
) -> list[tuple[float, float]]:
    """Roughly even places: one in each cell of a grid, at random inside the cell."""
    cols = max(round(math.sqrt(count * width / height)), 1)
    rows = max(round(count / cols), 1)
    places = [
        (
            (x + rng.uniform(0.05, 0.95)) * width / cols,
            (y + rng.uniform(0.05, 0.95)) * height / rows,
        )
        for y in range(rows)
        for x in range(cols)
    ]
    rng.shuffle(places)
    return places


def wallpaper(width: int, height: int, seed: int) -> np.ndarray:
    """Cream paper with faint stripes, stains and scattered plants."""
    rng = np.random.default_rng(seed)
    img = mix((0.80, 0.76, 0.66), (0.90, 0.87, 0.79), fbm((height, width), (3, 5), 5, rng))
    stripes = 0.5 + 0.5 * np.sin(np.arange(width) * 0.21 + 5.0 * fbm((1, width), (1, 9), 3, rng))
    img *= 0.97 + 0.03 * stripes.reshape(1, width, 1)
    return scatter(img, 150 * width // height, (0.03 * height, 0.05 * height), LEAVES, seed, 0.55)


def wood(
    width: int, height: int, seed: int, colours: Sequence[Colour], rings: float = 9.0
) -> np.ndarray:
    """Sawn wood with the grain along x: warped rings, streaks and dark pores."""
    rng = np.random.default_rng(seed)
    warp = fbm((height, width), (5, 2), 4, rng)
    across = np.linspace(0.0, 1.0, height, dtype=np.float32)[:, None]
    phase = rings * (across + 0.9 * warp)
    ring = (phase - np.floor(phase)) ** 1.6
    streak = fbm((height, width), (height / 8, 5), 3, rng)
    value = np.clip(0.55 * ring + 0.45 * streak, 0.0, 1.0)
    img = ramp(value, colours)
    pores = fbm((height, width), (height / 2, width / 40), 1, rng)
    img *= 1.0 - 0.2 * np.clip((pores - 0.72) * 6.0, 0.0, 1.0)[..., None]
    img *= (0.86 + 0.28 * fbm((height, width), (3, 3), 3, rng))[..., None]
    return np.clip(img, 0.0, 1.0)


def floor(width: int, height: int, planks: int, seed: int) -> np.ndarray:
    """Planks along x, each with its own cut of the wood, tone and joints."""
    rng = np.random.default_rng(seed)
    oak = ((0.32, 0.20, 0.12), (0.43, 0.28, 0.17), (0.53, 0.37, 0.23))
    stock = wood(2 * width, height, seed + 1, oak, rings=70.0)
    img = np.zeros((height, width, 3), np.float32)
    edges = np.linspace(0, height, planks + 1).astype(int)
    for y0, y1 in pairwise(edges):
        x0 = 0
        while x0 < width:
            x1 = min(x0 + int(rng.uniform(0.13, 0.36) * width), width)
            row = int(rng.integers(0, height - (y1 - y0)))
            col = int(rng.integers(0, 2 * width - (x1 - x0)))
            tone = rng.uniform(0.72, 1.25) * np.array([1.0, rng.uniform(0.94, 1.04), 1.0])
            img[y0:y1, x0:x1] = stock[row : row + y1 - y0, col : col + x1 - x0] * tone
            img[y0:y1, x0 : x0 + 2] *= 0.35
            x0 = x1
        img[y0 : y0 + 2] *= 0.35
    for x, y in jittered(90, width, height, rng):
        leaf(img, (x, y), rng.uniform(4, 11), rng.uniform(2, 6), 0.0, (0.13, 0.07, 0.04), 0.8)
    return np.clip(img, 0.0, 1.0)


def rug(width: int, height: int, seed: int) -> np.ndarray:
    """A knotted rug: borders, a medallion and scattered flowers, none alike."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    inset = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) / height
    wobble = 0.012 * (fbm((height, width), (9, 13), 3, rng) - 0.5)
    bands = ((0.03, 3), (0.045, 2), (0.16, 0), (0.175, 1), (0.19, 2), (9.0, 5))
    img = np.empty((height, width, 3), np.float32)
    low = -1.0
    for high, index in bands:
        img[(inset + wobble >= low) & (inset + wobble < high)] = WARM[index]
        low = high
    fx, fy = (x - width / 2) / width, (y - height / 2) / height
    radius = np.hypot(1.35 * fx, fy) + 0.02 * np.cos(12.0 * np.arctan2(fy, fx))
    for limit, index in ((0.27, 3), (0.255, 2), (0.16, 1), (0.145, 0), (0.07, 3)):
        img[radius < limit] = WARM[index]
    scatter(img, 900, (0.018 * height, 0.036 * height), WARM, seed + 1)
    knots = fbm((height, width), (height / 3, width / 3), 1, rng)
    img *= (0.86 + 0.18 * knots)[..., None]
    return np.clip(img * (0.85 + 0.2 * fbm((height, width), (4, 6), 3, rng))[..., None], 0.0, 1.0)


def fabric(
    width: int, height: int, seed: int, ground: Colour, colours: Sequence[Colour], count: int = 220
) -> np.ndarray:
    """Woven cloth with a scattered pattern."""
    rng = np.random.default_rng(seed)
    shade = 0.85 + 0.3 * fbm((height, width), (6, 6), 4, rng)
    img = np.asarray(ground, np.float32) * shade[..., None]
    scatter(img, count, (0.035 * height, 0.075 * height), colours, seed + 1)
    thread = fbm((height, width), (height / 2, width / 8), 1, rng)
    thread += fbm((height, width), (height / 8, width / 2), 1, rng)
    return np.clip(img * (0.92 + 0.08 * thread)[..., None], 0.0, 1.0)


def plaster(width: int, height: int, seed: int, light: Colour, dark: Colour) -> np.ndarray:
    """Mottled paint or plaster with fine specks."""
    rng = np.random.default_rng(seed)
    img = mix(dark, light, fbm((height, width), (5, 5), 7, rng, 0.62))
    specks = fbm((height, width), (height / 5, width / 5), 1, rng)
    return img * (1.0 - 0.3 * np.clip((specks - 0.86) * 9.0, 0.0, 1.0))[..., None]
