"""Puts the origin of a new object of Gaussians at its centre, to rotate, scale and frame it.

Objects of results that were loaded before keep their origin.
"""

from __future__ import annotations

from contextlib import suppress

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import mesh_of
from ..errors import AddonError
from ..geometry.frames import Matrix
from . import clouds, edits, lookup

MOST = 0.5
"""A box contains more than this share of its points, unless it was moved after training."""


def centre_on_box(scene: bpy.types.Scene, item: bpy.types.Object, roi: str) -> None:
    """Move the origin of a new object, whose points are in their file's frame, to its box."""
    if not roi or item.type != "MESH" or not len(mesh_of(item).vertices):
        return
    _move(item, _centre(scene, item, roi))


def centre_on_points(item: bpy.types.Object) -> None:
    """Move the origin of a new object, whose points are in their file's frame, to their middle."""
    if item.type == "MESH" and len(mesh_of(item).vertices):
        _move(item, _middle(clouds.positions(item)))


def _move(item: bpy.types.Object, place: Matrix) -> None:
    centre = place.astype(np.float32)  # as Blender keeps a location
    frame = np.eye(4)
    frame[:3, 3] = -centre
    edits.place(mesh_of(item), frame)
    item.location = centre.tolist()


def _centre(scene: bpy.types.Scene, item: bpy.types.Object, roi: str) -> Matrix:
    """Return the centre of the scene's box, else of the points without outliers."""
    points = clouds.positions(item)
    found = next((box for box in lookup.rois(scene) if box.name == roi), None)
    if found is not None:
        with suppress(AddonError):
            box = lookup.box(found, scene)
            if box.contains(points).mean() > MOST:
                return np.asarray(np.linalg.inv(box.world_to_box)[:3, 3], np.float64)
    return _middle(points)


def _middle(points: NDArray[np.float32]) -> Matrix:
    """Return the middle of points without outliers."""
    low, high = np.quantile(points, (0.02, 0.98), axis=0)
    return np.asarray((low + high) / 2, np.float64)
