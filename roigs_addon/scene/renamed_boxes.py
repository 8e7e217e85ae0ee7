"""Matches renamed boxes in another result by the place of their Gaussians.

Files of an earlier result keep the names that they had in training, and do not store the boxes.
"""

from __future__ import annotations

from collections.abc import Mapping

import bpy
import numpy as np

from ..geometry.overlap import Points, overlap
from ..properties import object_props
from . import ownership
from .splat_attributes import PLACE, values

SAME = 0.5
"""Overlap of Gaussians above which two boxes are one."""


def renamed(
    scene: bpy.types.Scene, fresh: Mapping[tuple[str, str], bpy.types.Object]
) -> dict[str, str]:
    """Return the present name -> the name in another result, for boxes that only differ in it.

    Args:
        scene: with the Gaussians that are shown.
        fresh: objects of the other result by level and box, not in the scene yet.
    """
    found = ((item, object_props(item)) for item in ownership.own_splats(scene))
    shown = {props.roi: item for item, props in found if props.level == "ROI"}
    theirs = {roi: item for (level, roi), item in fresh.items() if level == "ROI"}
    gone = {roi: _imported(item) for roi, item in shown.items() if roi not in theirs}
    new = {roi: _imported(item) for roi, item in theirs.items() if roi not in shown}
    pairs = sorted(
        ((overlap(gone[old], new[other]), old, other) for old in gone for other in new),
        reverse=True,
    )
    names: dict[str, str] = {}
    for share, old, other in pairs:
        if share > SAME and old not in names and other not in names.values():
            names[old] = other
    return names


def _imported(item: bpy.types.Object) -> Points:
    """(N, 3) an object's points as they were imported, before all edits."""
    mesh = item.data
    places = values(mesh, PLACE) if isinstance(mesh, bpy.types.Mesh) else None
    return np.zeros((0, 3), np.float32) if places is None else places
