"""What files say, cached: the scene's run folder, the log, the files of its Gaussians."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..engine import run_status
from ..engine.earlier_results import EarlierResult, earlier_results
from ..engine.run_status import RunStatus
from ..errors import AddonError
from ..jobs import run_folders
from ..properties import object_props
from ..scene import lookup

SECONDS = 1.0
"""How long what was found is used again."""

_runs: dict[Path, tuple[float, RunStatus]] = {}
_earlier: dict[Path, tuple[float, list[EarlierResult]]] = {}
_files: dict[Path, tuple[float, bool]] = {}
_missing: dict[str, tuple[float, list[str]]] = {}


def run(scene: bpy.types.Scene) -> RunStatus:
    """What the scene's run folder says."""
    folder = run_folders.run_folder(scene)
    if _is_old(_runs.get(folder)):
        _runs.clear()
        _runs[folder] = time.monotonic(), run_status.read(folder)
    return _runs[folder][1]


def earlier(scene: bpy.types.Scene) -> list[EarlierResult]:
    """Earlier results in the scene's run folder, newest first."""
    folder = run_folders.run_folder(scene)
    if _is_old(_earlier.get(folder)):
        _earlier.clear()
        _earlier[folder] = time.monotonic(), earlier_results(folder)
    return _earlier[folder][1]


def is_file(path: Path) -> bool:
    """Whether a file exists."""
    if _is_old(_files.get(path)):
        _files.clear()
        _files[path] = time.monotonic(), os.path.isfile(path)  # False where it may not look
    return _files[path][1]


def missing_splats(scene: bpy.types.Scene) -> list[str]:
    """Names of the Gaussians whose file is missing: nothing of them can be drawn."""
    if _is_old(_missing.get(scene.name)):
        files = {item.name: object_props(item).ply for item in lookup.splats(scene)}
        _missing.clear()
        missing = [name for name, file in files.items() if not os.path.isfile(file)]
        _missing[scene.name] = time.monotonic(), missing
    return _missing[scene.name][1]


def changed_boxes(scene: bpy.types.Scene, status: RunStatus) -> list[str]:
    """Names of the scene's boxes that have changed since they were trained, or are new."""
    trained = status.boxes or {}
    return [roi.name for roi in lookup.rois(scene) if not _is_as_trained(roi, scene, trained)]


def _is_as_trained(
    roi: bpy.types.Object, scene: bpy.types.Scene, trained: dict[str, tuple[Any, Any]]
) -> bool:
    if roi.name not in trained:
        return False
    try:
        box = lookup.box(roi, scene)
    except AddonError:
        return False
    matrix, half = trained[roi.name]
    size = float(np.max(box.half_extents))
    try:
        return bool(
            np.allclose(box.world_to_box, matrix, atol=1e-4 * max(size, 1.0))
            and np.allclose(box.half_extents, half, rtol=1e-4)
        )
    except (ValueError, TypeError, OverflowError):  # no numbers in the run folder's manifest
        return False


def _is_old(fact: tuple[float, object] | None) -> bool:
    """Whether to look again; always in scripts, which need what is true now."""
    return fact is None or bpy.app.background or time.monotonic() - fact[0] > SECONDS


def forget() -> None:
    """Look again at the next question."""
    _runs.clear()
    _earlier.clear()
    _files.clear()
    _missing.clear()
