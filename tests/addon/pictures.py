"""Reads pictures through Blender, which has no Pillow."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def load_png(path: Path) -> np.ndarray:
    """(H, W, 3) sRGB values in 0..1 of a picture, first row on top."""
    return load_rgba(path)[..., :3]


def load_rgba(path: Path) -> np.ndarray:
    """(H, W, 4) sRGB values and alpha in 0..1 of a picture, first row on top."""
    import bpy

    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1]


def read_png(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 of an 8-bit picture."""
    return (load_png(path) * 255).round().astype(np.uint8)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(a - b).mean() + 1e-12))


def linear(values: np.ndarray) -> np.ndarray:
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def srgb(values: np.ndarray) -> np.ndarray:
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * values ** (1 / 2.4) - 0.055)
