"""Counts for the panel, while it is drawn: points in a box, and photos that see it.

As in the engine, a photo sees a box if it observes one of the sparse points in it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import mesh_of
from ..engine.exported_model import read_numbers
from ..errors import AddonError
from ..geometry.box import Box
from ..properties import scene_props
from ..scene import clouds, lookup
from ..windows import Timer, redraw_sidebars
from ..worker import Worker

Counts = tuple[int, int | None]
Key = tuple[float, ...]
LARGE = 200_000
"""Number of points from which counting would slow down dragging a box."""

_counter = Worker("box counter")
_last: dict[str, Counts] = {}


class _Model:
    """Data of an imported model for counting, read once."""

    def __init__(self) -> None:
        self.key: tuple[object, ...] = ()
        self.points: NDArray[np.float32] = np.zeros((0, 3), np.float32)
        self.observations: NDArray[Any] | None = None
        self.offsets: NDArray[Any] | None = None
        self.counts: dict[Key, Counts] = {}

    def load(self, scene: bpy.types.Scene) -> None:
        """Read the points if the scene has another model now."""
        cloud = lookup.points(scene)
        folder = scene_props(scene).model_cache
        key = (folder, len(mesh_of(cloud).vertices) if cloud else 0)
        if key == self.key:
            return
        self.key, self.counts = key, {}
        self.observations = self.offsets = None
        try:
            self.points = read_numbers(Path(folder), "points.npy", 3)
            self.observations, self.offsets = _observed(Path(folder), len(self.points))
        except (OSError, ValueError):  # the cache was emptied; points can still be counted
            self.points = clouds.positions(cloud) if cloud else np.zeros((0, 3), np.float32)


def _observed(folder: Path, points: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Read the observed points, and the start of each photo's; raises OSError or ValueError."""
    rows = read_numbers(folder, "observed.npy")
    starts = read_numbers(folder, "observed_starts.npy")
    for numbers, most in ((rows, points - 1), (starts, len(rows))):
        if numbers.dtype.kind not in "iu" or (len(numbers) and not _within(numbers, most)):
            raise ValueError("observed.npy is of another model")
    return rows, starts


def _within(numbers: NDArray[Any], most: int) -> bool:
    return bool(numbers.min() >= 0 and numbers.max() <= most)


_model = _Model()


def count(roi: bpy.types.Object, scene: bpy.types.Scene) -> Counts | None:
    """Return (points in the box, photos that see it or None if unknown); None if it is no box."""
    try:
        box = lookup.box(roi, scene)
    except AddonError:
        return None
    _model.load(scene)
    return _known(_key(box)) or _keep(_key(box), _count(box))


def count_soon(roi: bpy.types.Object, scene: bpy.types.Scene) -> Counts | None:
    """Return `count` for a panel; for a large model the last one, until a thread has a new one."""
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
    timer.start()
    return _last[roi.name]


def _poll() -> bool:
    if not _counter.idle():
        return True
    redraw_sidebars()
    return False


timer = Timer(_poll, 0.05)
"""Redraws the panel when the thread is done."""


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
    # Number of observed points in the box before each observation: a photo sees one if it grows.
    before = np.concatenate([[0], np.cumsum(inside[observations])])
    return points, int((before[offsets[1:]] > before[offsets[:-1]]).sum())


def forget() -> None:
    """Clear the counts and the model."""
    global _model
    _last.clear()
    _model = _Model()


def close() -> None:
    """Forget everything, and end the thread."""
    global _counter
    forget()
    timer.stop()
    _counter.close()
    _counter = Worker("box counter")
