"""Live counts for the panel: points in a box, photos that see it. The engine's rule: a photo sees a
box when it observes one of the sparse points inside."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from . import clouds, jobs, lookup
from .errors import AddonError
from .frames import Box
from .viewport.worker import Worker

Counts = tuple[int, int | None]
Key = tuple[float, ...]
LARGE = 200_000
"""Points from which counting takes long enough to be felt while a box is dragged."""

_counter = Worker("box counter")
_last: dict[str, Counts] = {}


class _Model:
    """What counting needs of an imported model, kept while it is the same."""

    def __init__(self) -> None:
        self.key: tuple[object, ...] = ()
        self.points = np.zeros((0, 3), np.float32)
        self.observations: np.ndarray | None = None
        self.offsets: np.ndarray | None = None
        self.counts: dict[Key, Counts] = {}

    def load(self, scene: bpy.types.Scene) -> None:
        """Read the points again when another model is in the scene."""
        cloud = lookup.points(scene)
        folder = scene.roigs.model_cache
        key = (folder, len(cloud.data.vertices) if cloud else 0)
        if key == self.key:
            return
        self.key, self.counts = key, {}
        self.observations = self.offsets = None
        try:
            self.points = np.load(Path(folder) / "points.npy")
            self.observations = np.load(Path(folder) / "observed.npy", mmap_mode="r")
            self.offsets = np.load(Path(folder) / "observed_starts.npy", mmap_mode="r")
        except (OSError, ValueError):  # the cache was emptied: points can still be counted
            self.points = clouds.positions(cloud) if cloud else np.zeros((0, 3), np.float32)


_model = _Model()


def count(roi: bpy.types.Object, scene: bpy.types.Scene) -> Counts | None:
    """(points in the box, photos that see it or None when unknown); None when it is no box."""
    try:
        box = lookup.box(roi, scene)
    except AddonError:
        return None
    _model.load(scene)
    return _known(_key(box)) or _keep(_key(box), _count(box))


def count_soon(roi: bpy.types.Object, scene: bpy.types.Scene) -> Counts | None:
    """The same for a panel: in a large model, the last count until a thread has the new one."""
    try:
        box = lookup.box(roi, scene)
    except AddonError:
        return None
    _model.load(scene)
    outcome = _counter.take(roi.name)
    if outcome is not None and outcome.value is not None and outcome.value[0] == _model.key:
        _last[roi.name] = _keep(*outcome.value[1:])
    if known := _known(_key(box)):
        return known
    if len(_model.points) < LARGE or roi.name not in _last:
        _last[roi.name] = count(roi, scene) or (0, None)
        return _last[roi.name]
    model, key = _model.key, _key(box)
    _counter.submit(roi.name, lambda: (model, key, _count(box)))
    if not bpy.app.timers.is_registered(_redraw_when_counted):
        bpy.app.timers.register(_redraw_when_counted, first_interval=0.05)
    return _last[roi.name]


def _redraw_when_counted() -> float | None:
    if not _counter.idle():
        return 0.05
    jobs.redraw_sidebars()
    return None


def _key(box: Box) -> Key:
    return (*box.world_to_box.ravel(), *box.half_extents)


def _known(key: Key) -> Counts | None:
    return _model.counts.get(key)


def _keep(key: Key, found: Counts) -> Counts:
    if len(_model.counts) > 64:
        _model.counts.clear()
    _model.counts[key] = found
    return found


def _count(box: Box) -> Counts:
    inside = box.contains(_model.points)
    points = int(inside.sum())
    observations, offsets = _model.observations, _model.offsets
    if observations is None or offsets is None or not len(observations):  # a model without tracks
        return points, None
    # Points in the box before each observation: a photo's range that grows holds one.
    before = np.concatenate([[0], np.cumsum(inside[observations])])
    return points, int((before[offsets[1:]] > before[offsets[:-1]]).sum())


def forget() -> None:
    """Drop what was read."""
    global _model
    _last.clear()
    _model = _Model()


def close() -> None:
    """Drop what was read, and end the thread."""
    global _counter
    forget()
    if bpy.app.timers.is_registered(_redraw_when_counted):
        bpy.app.timers.unregister(_redraw_when_counted)
    _counter.close()
    _counter = Worker("box counter")
