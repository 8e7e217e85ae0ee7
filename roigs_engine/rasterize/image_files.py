"""Rendered images as 8-bit files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from ..formats.files import atomic_write


def to_uint8(image: Tensor) -> NDArray[np.uint8]:
    """(H, W, 3) values in [0, 1] -> (H, W, 3) uint8, rounded to nearest."""
    return (image.detach().clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()


def save_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Write (H, W, 3) uint8 as a PNG to `path`, atomically."""
    with atomic_write(path) as file:
        Image.fromarray(image).save(file, format="PNG")
