"""What the panel shows of files and programs, looked up seldom: a sidebar is drawn very often."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from pathlib import Path, PurePosixPath

import bpy
import numpy as np
from bpy.app.handlers import persistent

from . import counts, jobs, lookup, preferences, run_folders
from .engine import python, runs
from .errors import AddonError

SECONDS = 1.0
"""How long files are taken to be as they were."""

ENGINE_SECONDS = 5.0
"""How long an engine that lacks something is taken to lack it."""

_runs: dict[Path, tuple[float, runs.Run]] = {}
_files: dict[Path, tuple[float, bool]] = {}
_gone: dict[str, tuple[float, list[str]]] = {}
_names: dict[tuple[str, str, int], dict[str, str]] = {}


def run(scene: bpy.types.Scene) -> runs.Run:
    """The scene's run folder."""
    folder = run_folders.run_folder(scene)
    if _is_old(_runs.get(folder)):
        _runs.clear()
        _runs[folder] = time.monotonic(), runs.read(folder)
    return _runs[folder][1]


def is_file(path: Path) -> bool:
    """Whether a file is there."""
    if _is_old(_files.get(path)):
        _files.clear()
        _files[path] = time.monotonic(), os.path.isfile(path)  # False where it may not look
    return _files[path][1]


def gone(scene: bpy.types.Scene) -> list[str]:
    """Names of the Gaussians whose file is not where it was: nothing of them can be drawn."""
    if _is_old(_gone.get(scene.name)):
        files = {item.name: item.roigs.ply for item in lookup.splats(scene)}
        _gone.clear()
        _gone[scene.name] = time.monotonic(), [n for n in files if not os.path.isfile(files[n])]
    return _gone[scene.name][1]


def _is_old(fact: tuple[float, object] | None) -> bool:
    """Scripts do not draw, and want to know what is true now."""
    return fact is None or bpy.app.background or time.monotonic() - fact[0] > SECONDS


def changed(scene: bpy.types.Scene, found: runs.Run) -> list[str]:
    """Names of the scene's boxes that are not as they were trained, or were not trained."""
    trained = found.boxes or {}
    return [roi.name for roi in lookup.rois(scene) if not _same(roi, scene, trained)]


def _same(roi: bpy.types.Object, scene: bpy.types.Scene, trained: dict) -> bool:
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
    except (ValueError, TypeError, OverflowError):  # no numbers in the run folder's record
        return False


def photos(scene: bpy.types.Scene) -> int:
    """How many photos the scene has."""
    return len(_short_names(scene))


def short_name(scene: bpy.types.Scene, photo: str) -> str:
    """A photo's file name without folders and suffix, where no other photo has the same."""
    return _short_names(scene).get(photo, photo)


def _short_names(scene: bpy.types.Scene) -> dict[str, str]:
    key = (scene.roigs.colmap, scene.roigs.model_cache, len(scene.objects))
    if key not in _names:
        _names.clear()
        _names[key] = _shorter([*lookup.cameras(scene)])
    return _names[key]


def _shorter(photos: list[str]) -> dict[str, str]:
    seen = Counter(PurePosixPath(photo).stem for photo in photos)
    paths = {photo: PurePosixPath(photo) for photo in photos}
    return {photo: p.stem if seen[p.stem] == 1 else photo for photo, p in paths.items()}


class _EngineCheck:
    """Asks the engine's Python what it has, in a thread: that takes up to seconds."""

    def __init__(self) -> None:
        self.asked: tuple[str, Path] | None = None
        self.at = 0.0
        self.problem = ""
        self.thread: threading.Thread | None = None

    def ask(self) -> str:
        """Why it cannot train; empty when it can, or as long as that is not known."""
        if self.thread is not None and self.thread.is_alive():
            return self.problem
        question = preferences.chosen_python(), preferences.environments()
        old = self.problem and time.monotonic() - self.at > ENGINE_SECONDS
        if question != self.asked or old:
            self.asked = question
            self.thread = threading.Thread(target=self._look, args=question, daemon=True)
            self.thread.start()
            if not bpy.app.timers.is_registered(_redraw_when_known):
                bpy.app.timers.register(_redraw_when_known, first_interval=0.2)
        return self.problem

    def _look(self, chosen: str, home: Path) -> None:
        if self.problem:  # what was lacking may have been installed since
            python.ability.cache_clear()
        _, self.problem = python.find(chosen, home, python.FOR_TRAINING)
        self.at = time.monotonic()


_engine = _EngineCheck()


def engine_problem() -> str:
    """Why the engine cannot train, as far as is known by now."""
    return _engine.ask()


def _redraw_when_known() -> float | None:
    if _engine.thread is not None and _engine.thread.is_alive():
        return 0.2
    jobs.redraw_sidebars()
    return None


@persistent
def forget(*_: object) -> None:
    """Look again at the next drawing; also called when a file was loaded."""
    _runs.clear()
    _files.clear()
    _gone.clear()
    _names.clear()


def register() -> None:
    """Another file has other facts."""
    bpy.app.handlers.load_post.append(forget)
    jobs.on_end.append(forget)


def unregister() -> None:
    """The reverse."""
    forget()
    counts.close()
    jobs.on_end.remove(forget)
    bpy.app.handlers.load_post.remove(forget)
    if bpy.app.timers.is_registered(_redraw_when_known):
        bpy.app.timers.unregister(_redraw_when_known)
