"""`rois.json`: boxes in the COLMAP frame (docs/files.md). No bpy."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import AddonError
from ..geometry.box import Box


def read_rois(path: Path) -> dict[str, Box]:
    """The boxes of a file by name.

    Raises:
        AddonError: it cannot be read, or one of its entries is not a box.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise AddonError(f"{path} cannot be read ({error}).") from error
    records = document.get("rois") if isinstance(document, dict) else document
    if not isinstance(records, list) or not records:
        raise AddonError(f"{path} has no boxes. It needs a list 'rois', see docs/files.md.")
    boxes: dict[str, Box] = {}
    for number, record in enumerate(records, start=1):
        try:
            name, box = str(record["name"]), _from_record(record)
        except (KeyError, TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
            raise AddonError(f"Entry {number} of {path} is not a box ({error}).") from error
        if name in boxes:
            raise AddonError(f"{path} has two boxes named '{name}'. Give each its own name.")
        boxes[name] = box
    return boxes


def write_rois(path: Path, boxes: Iterable[tuple[str, Box]]) -> None:
    """Write boxes with their names, for the engine."""
    records = [to_record(name, box) for name, box in boxes]
    path.write_text(json.dumps({"rois": records}, indent=1, ensure_ascii=False), encoding="utf-8")


def to_record(name: str, box: Box) -> dict[str, Any]:
    """A box as an entry of the file."""
    return {
        "name": name,
        "world_to_box": box.world_to_box.tolist(),
        "half_extents": box.half_extents.tolist(),
    }


def from_corners(low: Any, high: Any) -> Box:
    """The box between two corners, along the axes of the COLMAP frame.

    Raises:
        ValueError: it has no volume.
    """
    corners = np.array([low, high], dtype=np.float64)
    half = (corners[1] - corners[0]) / 2
    if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (half > 0).all():
        raise ValueError("each coordinate of the second corner must be larger than the first's")
    world_to_box = np.eye(4)
    world_to_box[:3, 3] = -corners.mean(axis=0)
    return Box(world_to_box=world_to_box, half_extents=half)


def _from_record(record: dict[str, Any]) -> Box:
    if "min" in record or "max" in record:
        return from_corners(record["min"], record["max"])
    matrix = np.array(record["world_to_box"], dtype=np.float64)
    half = np.array(record["half_extents"], dtype=np.float64)
    if matrix.shape != (4, 4) or half.shape != (3,) or not (half > 0).all():
        raise ValueError("it needs a 4 x 4 matrix and three half extents above 0")
    rotation = matrix[:3, :3]
    if not np.isfinite(matrix).all() or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
        raise ValueError("its matrix must be a rotation and a translation")
    return Box(world_to_box=matrix, half_extents=half)
