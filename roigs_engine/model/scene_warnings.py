"""Warnings before training: scenes and boxes that will give poor results."""

from __future__ import annotations

from collections.abc import Sequence

from .ownership import nearest_owner
from .roi import OrientedBox
from .scene import SfmScene

FEW = 5  # photos of a box; with fewer, most of its surface is seen once or never


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


def few_photos(roi: str, count: int, *, points: int = 1) -> list[str]:
    """The warning about a box with `points` points that `count` photos see, if it is too little."""
    if points == 0:
        return [f"No point lies in box '{roi}': move it onto the object, or enlarge it."]
    match count:
        case 0:
            return [f"No photo sees box '{roi}': move or enlarge it, or add photos of it."]
        case 1:
            return [f"Only one photo sees box '{roi}': that is too few to reconstruct an object."]
        case _ if count < FEW:
            return [
                f"Only {count} photos see box '{roi}': it will look right only from their"
                " directions. Add photos of it."
            ]
    return []
