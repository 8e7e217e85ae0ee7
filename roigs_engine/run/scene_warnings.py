"""Warnings before training: scenes and boxes that will give poor results."""

from __future__ import annotations

from collections.abc import Sequence

from ..model.ownership import nearest_owner
from ..model.roi import OrientedBox
from ..model.scene import SfmScene


def scene_warnings(scene: SfmScene, rois: Sequence[OrientedBox]) -> list[str]:
    """Warnings about a scene and its boxes, one sentence each; empty if there are none."""
    return _without_points_of_their_own(scene, list(rois))


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
