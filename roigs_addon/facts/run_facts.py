"""Caches facts from files: the scene's run folder, its results, the files of its Gaussians."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..engine import own_files, photo_exposures, report, run_status
from ..engine.earlier_results import EarlierResult, earlier_results
from ..engine.run_settings import RunSettings
from ..engine.run_status import RunStatus
from ..jobs import run_folders
from ..properties import object_props
from ..scene import edits, lookup, rois
from ..shared import clean_up, files, run_files

SECONDS, DISK_SECONDS = 1.0, 30.0
"""Lifetime of cached facts; that of disk sizes is longer, because adding up files is slow."""

OWN_LEVELS = ("IMPORTED", "PREVIEW")
"""Levels of Gaussians that do not belong to a result."""


@dataclass(frozen=True, kw_only=True)
class ResultFacts:
    """The last result of the run folder.

    Attributes:
        settings: of its training.
        psnr: in words.
        exposures: photo -> stops above the usual exposure; empty: training levelled none.
    """

    settings: RunSettings
    psnr: str
    exposures: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class Disk:
    """Bytes of the run folder, and of the files that **Clean Up** would remove."""

    total: int
    removable: int


_runs: dict[Path, tuple[float, RunStatus]] = {}
_earlier: dict[Path, tuple[float, list[EarlierResult]]] = {}
_files: dict[Path, tuple[float, bool]] = {}
_results: dict[Path, tuple[float, ResultFacts]] = {}
_disk: dict[Path, tuple[float, Disk]] = {}
_lost: dict[str, tuple[float, list[str]]] = {}


def run(scene: bpy.types.Scene) -> RunStatus:
    """Return the state of the scene's run folder."""
    folder = run_folders.run_folder(scene)
    if is_old(_runs.get(folder)):
        _runs.clear()
        _runs[folder] = time.monotonic(), run_status.read(folder)
    return _runs[folder][1]


def earlier(scene: bpy.types.Scene) -> list[EarlierResult]:
    """Earlier results in the scene's run folder, newest first."""
    folder = run_folders.run_folder(scene)
    if is_old(_earlier.get(folder)):
        _earlier.clear()
        _earlier[folder] = time.monotonic(), earlier_results(folder)
    return _earlier[folder][1]


def result(scene: bpy.types.Scene) -> ResultFacts:
    """Return the facts about the last result."""
    folder = run_folders.run_folder(scene)
    if is_old(_results.get(folder)):
        _results.clear()
        found = ResultFacts(
            settings=run(scene).settings,
            psnr=report.psnr(folder),
            exposures=photo_exposures.read(folder),
        )
        _results[folder] = time.monotonic(), found
    return _results[folder][1]


def disk(scene: bpy.types.Scene) -> Disk:
    """The disk space of the scene's run folder."""
    folder = run_folders.run_folder(scene)
    if is_old(_disk.get(folder), DISK_SECONDS):
        _disk.clear()
        # Only files of a run: an untrusted .blend may name any folder, such as `/`.
        own = [path for path in files.matching(folder, "*") if _is_of_run(path.name)]
        total, removable = clean_up.disk_size(own), clean_up.removable(folder)
        found = Disk(total=total, removable=clean_up.disk_size(removable))
        _disk[folder] = time.monotonic(), found
    return _disk[folder][1]


def _is_of_run(name: str) -> bool:
    return run_files.is_own(name) or name == own_files.OWN


def is_file(path: Path) -> bool:
    """Whether a file exists."""
    if is_old(_files.get(path)):
        _files.clear()
        _files[path] = time.monotonic(), os.path.isfile(path)  # False without permission
    return _files[path][1]


def lost_splats(scene: bpy.types.Scene) -> list[str]:
    """Return the names of a result's Gaussians whose files are lost: the .blend's are drawn."""
    if is_old(_lost.get(scene.name)):
        shown = ((item, object_props(item)) for item in lookup.splats(scene))
        own = [(i, p.ply) for i, p in shown if not p.parked and p.level not in OWN_LEVELS]
        _lost.clear()
        lost = [item.name for item, file in own if not edits.is_held(item, file)]
        _lost[scene.name] = time.monotonic(), lost
    return _lost[scene.name][1]


def changed_boxes(scene: bpy.types.Scene, status: RunStatus) -> list[str]:
    """Return the names of boxes that changed since their training, are new or were removed."""
    trained, now = status.boxes or {}, [roi.name for roi in lookup.rois(scene)]
    same = rois.trained_names(scene, trained)
    gone = trained.keys() - set(now) - set(same.values())
    return [
        *(name for name in now if name not in same),
        *(f"{name} (removed)" for name in sorted(gone)),
    ]


def is_old(fact: tuple[float, object] | None, seconds: float = SECONDS) -> bool:
    """Whether a cached fact has expired; always in scripts, which need the present state."""
    return fact is None or bpy.app.background or time.monotonic() - fact[0] > seconds


def forget() -> None:
    """Clear the caches."""
    _runs.clear()
    _earlier.clear()
    _results.clear()
    _disk.clear()
    _files.clear()
    _lost.clear()
