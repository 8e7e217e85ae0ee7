"""Warnings before training: scenes and boxes that will give poor results."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..model.ownership import nearest_owner
from ..model.roi import OrientedBox
from ..model.scene import SfmScene

MAX_REACH = 1e4  # distance from the origin in scene sizes; farther away float32 is too coarse


def scene_warnings(scene: SfmScene, rois: Sequence[OrientedBox]) -> list[str]:
    """Warnings about a scene and its boxes, one sentence each; empty if there are none."""
    return [*_far_from_its_origin(scene), *_without_points_of_their_own(scene, list(rois))]


def _far_from_its_origin(scene: SfmScene) -> list[str]:
    reach, extent = float(np.abs(scene.centres()).max(initial=0.0)), scene.extent()
    if reach <= MAX_REACH * extent:
        return []
    times = reach / max(extent, 1e-9)
    return [
        f"The model lies {reach:.3g} units from the origin, {times:.3g} times its size: 32-bit"
        " positions are too coarse there. Move it to the origin first (COLMAP's model_transformer)."
    ]


def _without_points_of_their_own(scene: SfmScene, rois: list[OrientedBox]) -> list[str]:
    owner, found = nearest_owner(scene.points, rois), []
    for index, roi in enumerate(rois):
        inside = int(roi.contains(scene.points).sum())
        if inside and not (owner == index).any():
            found.append(
                f"Box '{roi.name}' owns none of its {inside:,} points: all are nearer to the centre"
                f" of another box. Move the boxes apart, or train it alone (--only {roi.name})."
            )
    return found
