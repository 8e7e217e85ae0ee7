"""A COLMAP project so small that an engine is done with it in seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT, FOCAL, RADIUS = 96, 72, 95.0, 4.0
BOX = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"


def write_scene(folder: Path, *, photos: int = 10, points: int = 40, seed: int = 7) -> None:
    """Write a project with cameras on a ring around points; photos show the points as dots.

    Args:
        folder: the project's folder.
        photos, points: numbers of photos and points.
        seed: for the points.
    """
    world = np.random.default_rng(seed).uniform(-0.8, 0.8, (points, 3))
    model, images = folder / "sparse" / "0", folder / "images"
    model.mkdir(parents=True, exist_ok=True)
    images.mkdir(exist_ok=True)
    principal = f"{WIDTH / 2} {HEIGHT / 2}"
    camera = f"1 PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {principal}\n"
    (model / "cameras.txt").write_text(camera, encoding="utf-8")
    rows = [f"{k + 1} {x} {y} {z} 90 100 200 0\n" for k, (x, y, z) in enumerate(world)]
    (model / "points3D.txt").write_text("".join(rows), encoding="utf-8")
    lines = []
    for index in range(photos):
        turn = Rotation.from_euler("y", 2 * np.pi * index / photos)
        local = turn.apply(world) + np.array([0, 0, RADIUS])
        x, y, z, w = turn.as_quat()
        lines.append(f"{index + 1} {w} {x} {y} {z} 0 0 {RADIUS} 1 {index}.png\n\n")
        pixels = local[:, :2] / local[:, 2:] * FOCAL + (WIDTH / 2, HEIGHT / 2)
        _paint(pixels).save(images / f"{index}.png")
    (model / "images.txt").write_text("".join(lines), encoding="utf-8")


def _paint(pixels: NDArray[np.float64]) -> Image.Image:
    """Draw a photo with a soft dot at each of (P, 2) pixels."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    photo = np.full((HEIGHT, WIDTH), 20.0)
    for px, py in pixels:
        photo += 220 * np.exp(-((x - px) ** 2 + (y - py) ** 2) / 4.5)
    return Image.fromarray(photo.clip(0, 255).round().astype(np.uint8)).convert("RGB")
