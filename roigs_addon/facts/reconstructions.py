"""Reads the state of the scene's reconstruction from its folder; cached."""

from __future__ import annotations

import time
from pathlib import Path

import bpy

from ..engine import reconstruction
from ..engine.reconstruction import ReconstructionStatus
from ..jobs import reconstruct_job
from ..properties import scene_props
from .run_facts import is_old

Found = tuple[Path, ReconstructionStatus, Path | None]

_found: dict[tuple[str, str, str], tuple[float, Found]] = {}


def of(scene: bpy.types.Scene) -> Found:
    """Return the folder, its state, and the folder of masks; for a scene with photos."""
    props = scene_props(scene)
    key = props.photos, props.project, props.masks
    if is_old(_found.get(key)):
        _found.clear()
        folder = reconstruct_job.project_folder(scene)
        _found[key] = (
            time.monotonic(),
            (
                folder,
                reconstruction.read(folder),
                reconstruct_job.masks_folder(scene),
            ),
        )
    return _found[key][1]


def report(scene: bpy.types.Scene) -> Path | None:
    """Return the report of the scene's reconstruction; None if there is none."""
    if not scene_props(scene).photos:
        return None
    folder, status, _ = of(scene)
    return folder / reconstruction.REPORT if status.summary else None


def forget() -> None:
    """Clear the cache."""
    _found.clear()
