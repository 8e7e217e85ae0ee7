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
