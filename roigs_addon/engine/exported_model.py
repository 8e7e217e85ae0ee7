"""Reads an exported model (docs/files.md) from the folder named in a .blend. No bpy.

The author of the .blend chose the folder, and panels read it while they are drawn. So the code here
never waits for a pipe, needs no more memory than the file has bytes, and runs no code from it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..shared import files, text

RECORD = "scene.json"
MOST_BYTES = 256 << 20
"""Size limit of the record; with 20,000 photos it has 14 MB."""


def read_record(folder: Path) -> dict[str, Any]:
    """Read the description of a model: a JSON object whose `images` are objects with a `name`.

    OSError or ValueError: there is none, or it is damaged.
    """
    record = text.parse_json(files.read_bytes(folder / RECORD, MOST_BYTES))
    images = record.get("images") if isinstance(record, dict) else None
    if not isinstance(images, list) or not all(map(_is_named, images)):
        raise ValueError(f"{RECORD} has no list of images")
    found: dict[str, Any] = record
    return found


def _is_named(image: Any) -> bool:
    return isinstance(image, dict) and isinstance(image.get("name"), str)


def read_numbers(folder: Path, name: str, width: int = 0) -> NDArray[Any]:
    """Read an array of numbers from a file: (N,), or (N, `width`) if `width` is given.

    The file is not memory-mapped: Blender crashes if a mapped file is lost, as on a network drive.
    OSError or ValueError: it is missing, damaged, or has another shape.
    """
    with open(folder / name, "rb", opener=files.regular) as file:
        formats: Any = np.lib.format  # without types
        first = formats.read_magic(file) == (1, 0)
        header = formats.read_array_header_1_0 if first else formats.read_array_header_2_0
        shape, _, kind = header(file)
        begin, size = file.tell(), file.seek(0, 2)
        if kind.kind not in "iuf" or begin + math.prod(shape) * kind.itemsize > size:
            raise ValueError(f"{name} is cut off, or has no numbers")
        if len(shape) != 1 + bool(width) or (width and shape[1] != width):
            raise ValueError(f"{name} has another shape")
        file.seek(0)
        found: NDArray[Any] = np.load(file, allow_pickle=False)
        return found
