"""Live counts for the panel: points in a box, photos that see it. The engine's rule: a photo sees a
box when it observes one of the sparse points inside."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from . import clouds, lookup
from .errors import AddonError
from .frames import Box

Counts = tuple[int, int | None]


class _Model:
    """What counting needs of an imported model, kept while it is the same."""

    def __init__(self) -> None:
        self.key: tuple[object, ...] = ()
        self.points = np.zeros((0, 3), np.float32)
        self.observations: np.ndarray | None = None
        self.offsets: np.ndarray | None = None
        self.counts: dict[tuple[float, ...], Counts] = {}

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
    key = (*box.world_to_box.ravel(), *box.half_extents)
    if key not in _model.counts:
        if len(_model.counts) > 64:
            _model.counts.clear()
        _model.counts[key] = _count(box)
    return _model.counts[key]


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
    _model.__init__()  # type: ignore[misc]
