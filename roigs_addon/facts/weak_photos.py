"""Finds photos with so few observed points that their cameras may be wrong."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ..engine import exported_model
from ..properties import scene_props
from ..scene import exclusions
from ..shared import projects

_found: dict[str, list[str]] = {}


def used(scene: bpy.types.Scene) -> list[str]:
    """Return the names of weak photos, the weakest first, without excluded ones."""
    folder = scene_props(scene).model_cache
    if folder not in _found:
        _found.clear()
        _found[folder] = _weak(Path(folder))
    return [name for name in _found[folder] if not exclusions.is_excluded(scene, name)]


def _weak(folder: Path) -> list[str]:
    """Return the weak photos of an exported model; none if it is missing or has no observations."""
    try:
        starts = exported_model.read_numbers(folder, "observed_starts.npy")
        images = exported_model.read_record(folder)["images"]
        points = np.diff(starts).tolist()
        counts = {image["name"]: int(n) for image, n in zip(images, points, strict=True)}
    except (OSError, ValueError, OverflowError):
        return []
    return projects.weakly_observed(counts) if any(points) else []


def forget() -> None:
    """Clear the cache."""
    _found.clear()
