# SPDX-License-Identifier: GPL-3.0-or-later
"""Paintings and prints in the demo room: pictures, maps, newspapers, labels, a dial.

Arrays as in `textures`.
"""

from __future__ import annotations

import math

import numpy as np
from textures import LEAVES, WARM, Colour, fbm, flower, jittered, leaf, mix, ramp, scatter


def landscape(width: int, height: int, seed: int) -> np.ndarray:
    """A painted view: sky, ridges one before the other, brush strokes."""
    rng = np.random.default_rng(seed)
    sky = ramp(
        np.clip(
            np.linspace(0, 1, height)[:, None] + 0.3 * fbm((height, width), (5, 4), 5, rng), 0, 1
        ),
        ((0.95, 0.83, 0.66), (0.80, 0.80, 0.78), (0.45, 0.60, 0.74)),
    )
    img = sky.copy()
    y = np.linspace(0.0, 1.0, height)[:, None]
    for depth in range(6):
        ridge = 0.62 - 0.1 * depth + (0.2 - 0.02 * depth) * (fbm((1, width), (1, 4), 6, rng) - 0.5)
        near = np.array([0.20, 0.30, 0.16]) * rng.uniform(0.7, 1.5, 3)
        tone = near + (np.array([0.62, 0.68, 0.72]) - near) * (1.0 - depth / 5.0) ** 1.3
        stroke = 0.7 + 0.6 * fbm((height, width), (height / 14, width / 40), 3, rng)
        mask = y < ridge
        img[mask] = (tone * stroke[..., None])[mask]
    for x, spot in jittered(260, width, int(0.35 * height), rng):
        flower(img, (x, spot), rng.uniform(5, 14), 6, rng.uniform(0, 6), WARM[rng.integers(4)])
    return np.clip(img, 0.0, 1.0)


def bouquet(width: int, height: int, seed: int) -> np.ndarray:
    """A dark still life full of flowers."""
    rng = np.random.default_rng(seed)
    img = mix((0.10, 0.09, 0.08), (0.30, 0.24, 0.18), fbm((height, width), (4, 4), 6, rng))
    for k in range(320):
        spread = rng.normal(0.0, 0.19, 2)
        place = ((0.5 + spread[0]) * width, (0.56 + spread[1]) * height)
        angle = math.atan2(spread[1], spread[0])
        if k % 3:
            leaf(img, place, rng.uniform(20, 60), rng.uniform(7, 16), angle, LEAVES[k % 4])
        else:
            colour = tuple(np.clip(np.array(WARM[k % 4]) * rng.uniform(0.8, 1.4), 0, 1))
            flower(img, place, rng.uniform(18, 46), int(rng.integers(5, 11)), angle, colour)
    return img


def contour_map(width: int, height: int, seed: int) -> np.ndarray:
    """An invented map: coast, contour lines, rivers, a grid, little places."""
    rng = np.random.default_rng(seed)
    land = fbm((height, width), (3, 4), 6, rng)
    img = ramp(
        land,
        (
            (0.42, 0.58, 0.66),
            (0.62, 0.74, 0.74),
            (0.84, 0.82, 0.62),
            (0.74, 0.62, 0.42),
            (0.9, 0.86, 0.8),
        ),
    )
    lines = np.abs((land * 18.0) % 1.0 - 0.5) > 0.46
    img[lines] *= 0.6
    img[:: height // 9, :] *= 0.7
    img[:, :: width // 11] *= 0.7
    for x, y in jittered(150, width, height, rng):
        leaf(img, (x, y), rng.uniform(2, 6), rng.uniform(2, 6), 0.0, WARM[rng.integers(6)], 1.0)
    return np.clip(img, 0.0, 1.0)


def patchwork(width: int, height: int, seed: int) -> np.ndarray:
    """A geometric composition of unequal rectangles and discs."""
    rng = np.random.default_rng(seed)
    img = mix((0.86, 0.82, 0.72), (0.94, 0.91, 0.84), fbm((height, width), (8, 8), 4, rng))
    for _ in range(60):
        x0, y0 = int(rng.integers(width)), int(rng.integers(height))
        w, h = (int(v) for v in rng.integers(20, 190, 2))
        tone = np.array(WARM[rng.integers(len(WARM))]) * rng.uniform(0.7, 1.3)
        img[y0 : y0 + h, x0 : x0 + w] = 0.25 * img[y0 : y0 + h, x0 : x0 + w] + 0.75 * tone
        if rng.random() < 0.5:
            size = rng.uniform(8, 60)
            leaf(img, (x0, y0), size, size, rng.uniform(0, 3), tuple(tone[::-1]), 0.9)
    return np.clip(img * (0.88 + 0.2 * fbm((height, width), (60, 60), 2, rng))[..., None], 0, 1)


def newsprint(width: int, height: int, seed: int) -> np.ndarray:
    """A page of columns of dark strokes, as print looks from afar."""
    rng = np.random.default_rng(seed)
    img = mix((0.80, 0.78, 0.72), (0.90, 0.88, 0.83), fbm((height, width), (6, 4), 4, rng))
    column = width // 4
    for c in range(4):
        y = height - 30 - int(rng.integers(0, 60))
        while y > 24:
            tall = 14 if rng.random() < 0.06 else 5
            x = c * column + 12
            while x < (c + 1) * column - 16:
                word = int(rng.integers(5, 30))
                end = min(x + word, (c + 1) * column - 12)
                ink = rng.random((tall, end - x, 1)) * 0.7
                img[y : y + tall, x:end] *= ink
                x += word + 5
            y -= tall + 5
            if rng.random() < 0.03:
                y -= 70
                img[max(y, 0) : y + 60, c * column + 14 : (c + 1) * column - 14] *= 0.45
    return img


def filigree(width: int, height: int, seed: int, ground: Colour, gold: Colour) -> np.ndarray:
    """Fine engraved lines (a guilloche) whose beat changes over the surface."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) / height
    bend = fbm((height, width), (3, 3), 2, rng) * 0.8
    a = np.sin(2 * np.pi * (21 * x + 6 * np.sin(2 * np.pi * (1.3 * y + bend)) / 6 + 4 * bend))
    b = np.sin(2 * np.pi * (17 * y + 5 * np.sin(2 * np.pi * (1.1 * x - bend)) / 5))
    lines = np.clip(1.0 - np.abs(a * b) * 5.0, 0.0, 1.0)
    dots = np.clip((np.abs(a) + np.abs(b) - 1.86) * 20.0, 0.0, 1.0)
    img = mix(ground, gold, np.maximum(lines * 0.75, dots))
    scatter(img, 70, (0.02 * height, 0.05 * height), (gold, WARM[0], WARM[3], WARM[1]), seed + 1)
    return np.clip(img * (0.85 + 0.25 * fbm((height, width), (9, 9), 4, rng))[..., None], 0, 1)


def label(width: int, height: int, seed: int) -> np.ndarray:
    """The ground of a printed label: old paper, double frame, engraved corners."""
    rng = np.random.default_rng(seed)
    img = mix((0.84, 0.77, 0.60), (0.95, 0.91, 0.80), fbm((height, width), (5, 4), 7, rng, 0.6))
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    inset = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y))
    wave = 5.0 * np.sin((x + y) * 0.13) * np.sin((x - y) * 0.11)
    for low, high, colour in (
        (0, 10, (0.16, 0.22, 0.18)),
        (16, 21, WARM[0]),
        (26, 62, (0.22, 0.32, 0.26)),
        (67, 71, WARM[1]),
    ):
        shift = wave if high == 62 else 0.0
        img[(inset + shift >= low) & (inset < high)] = colour
    lace = (inset > 30) & (inset < 58) & (np.sin(x * 0.31) * np.sin(y * 0.29) > 0.35)
    img[lace] = (0.86, 0.74, 0.42)
    for cx in (90, width - 90):
        for cy in (90, height - 90):
            petals = int(rng.integers(7, 14))
            flower(img, (cx, cy), 58, petals, rng.uniform(0, 3), WARM[rng.integers(3)])
    return np.clip(img, 0.0, 1.0)


def dial(size: int, seed: int) -> np.ndarray:
    """The plate of a clock: engraved rays and rings, a minute track, a worn rim."""
    rng = np.random.default_rng(seed)
    y, x = (np.mgrid[0:size, 0:size].astype(np.float32) + 0.5) / size * 2.0 - 1.0
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    img = mix((0.84, 0.79, 0.66), (0.95, 0.92, 0.84), fbm((size, size), (5, 5), 7, rng, 0.6))
    guilloche = np.sin(72 * angle + 9 * np.sin(26 * radius)) * np.sin(34 * np.pi * radius)
    engraved = radius < 0.46
    img[engraved] *= (0.72 + 0.28 * (guilloche > 0.0))[engraved][..., None]
    petals = np.abs(np.cos(6 * angle)) * 0.30
    img[(radius < petals) & (radius > 0.06)] = (0.24, 0.30, 0.44)
    img[(radius < petals - 0.03) & (radius > 0.08)] = (0.76, 0.56, 0.24)
    for low, high, colour in (
        (0.46, 0.475, (0.20, 0.16, 0.12)),
        (0.80, 0.808, (0.20, 0.16, 0.12)),
        (0.865, 0.873, (0.20, 0.16, 0.12)),
        (0.93, 2.0, (0.45, 0.30, 0.14)),
    ):
        img[(radius >= low) & (radius < high)] = colour
    minutes = np.abs(((angle / (2 * np.pi) * 60) % 1.0) - 0.5) > 0.42
    img[minutes & (radius > 0.808) & (radius < 0.865)] = (0.12, 0.10, 0.09)
    return np.clip(img, 0.0, 1.0)
