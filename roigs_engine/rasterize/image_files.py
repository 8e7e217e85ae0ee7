"""Rendered images as 8-bit files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from ..formats.files import atomic_write
from .placed import Layer


def to_uint8(image: Tensor) -> NDArray[np.uint8]:
    """(H, W, 3) values in [0, 1] -> (H, W, 3) uint8, rounded to nearest."""
    return (image.detach().clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()


def save_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Write (H, W, 3) uint8 as a PNG to `path`, atomically."""
    with atomic_write(path) as file:
        Image.fromarray(image).save(file, format="PNG")


def save_layer(colour: Path, depth: Path, layer: Layer) -> None:
    """Write a layer: an sRGB PNG with transparency, last, and before it a TIFF of 32-bit depths."""
    with atomic_write(depth) as file:
        Image.fromarray(layer.depth.numpy().astype(np.float32)).save(file, format="TIFF")
    rgba = torch.cat([layer.image, layer.alpha[..., None]], dim=-1)
    with atomic_write(colour) as file:
        Image.fromarray(to_uint8(rgba)).save(file, format="PNG", compress_level=1)
