"""The pixels of Blender's images as arrays."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray


def pixels_of(image: bpy.types.Image) -> NDArray[np.float32]:
    """(H, W, channels) pixels of an image, bottom row first; empty if it cannot be read."""
    width, height = image.size
    flat = np.empty(width * height * image.channels, np.float32)
    values: Any = image.pixels
    if flat.size:
        values.foreach_get(flat)
    return flat.reshape(height, width, -1) if flat.size else np.zeros((0, 0, 4), np.float32)
