"""Views for a web page: each object except the background, from the direction of its photos."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from ..blender import mesh_of
from ..geometry import frames
from ..properties import object_props
from ..shared import names
from . import clouds, lookup, splats
from .frame_request import standing

MOST = 2, 98
"""Percentiles of an object's Gaussians that its box spans: some Gaussians lie far out."""
LEAST = 1e-4
"""Added to each end of a box's sides: `rois.json` allows no flat boxes."""


def boxes(
    items: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> list[dict[str, Any]]:
    """Return boxes in the world, in the form of `rois.json`; none for a single object."""
    found: dict[str, dict[str, Any]] = {}
    for item, moved, matrix in standing(items, depsgraph) if len(items) > 1 else ():
        mesh = mesh_of(item)
        if object_props(moved).level == "RESULT" or not mesh.vertices:
            continue
        points = clouds.positions(item) @ matrix[:3, :3].T + matrix[:3, 3]
        low, high = np.percentile(points, MOST, axis=0)
        name = _name(item)
        if names.first_taken([*found, name]) is None:
            record = {"min": (low - LEAST).tolist(), "max": (high + LEAST).tolist()}
            found[name] = {"name": name, **record}
    return list(found.values())


def photos(scene: bpy.types.Scene, items: Sequence[bpy.types.Object]) -> list[list[list[float]]]:
    """Return world to camera of each photo's camera as it stands now; none without the background.

    Seen from the photos, an object without the background could be small or out of the picture.
    """
    if not any(object_props(item).level == "RESULT" for item in items):
        return []
    cameras = lookup.cameras(scene).values()
    places = [lookup.matrix_world(camera) for camera in cameras]
    return [frames.world_to_camera(place, np.eye(4)).tolist() for place in places]


def _name(item: bpy.types.Object) -> str:
    """Return an object's name as in the panel: its box's, unless it is a copy or was renamed."""
    props = object_props(item)
    own = item.name != splats.object_name(props.level, props.roi)
    name = item.name if own else props.roi
    return name if names.is_file_name(name) else names.safe_name(name)
