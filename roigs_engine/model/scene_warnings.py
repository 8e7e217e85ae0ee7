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


def few_photos(roi: str, count: int, *, points: int = 1, tests: int = 0) -> list[str]:
    """The warning about a box that too few photos see, if they are too few.

    Args:
        roi: the box's name.
        count: photos that see it, without test photos.
        points: in the box.
        tests: test photos that see it.
    """
    kind, others = kind_of_photos(count, tests)
    if points == 0:
        return [f"No point lies in box '{roi}': move it onto the object, or enlarge it."]
    match count:
        case 0:
            return [f"No photo sees box '{roi}': move or enlarge it, or add photos of it."]
        case 1:
            return [
                f"Only one {kind} sees box '{roi}'{others}: that is too few to reconstruct an"
                " object."
            ]
        case _ if count < FEW:
            return [
                f"Only {count} {kind}s see box '{roi}'{others}: it will look right only from"
                " their directions. Add photos of it."
            ]
    return []


def kind_of_photos(count: int, tests: int) -> tuple[str, str]:
    """What photos of a box are called, and the words about test photos behind its name.

    Args:
        count: photos that see the box, without test photos.
        tests: test photos that see it.
    """
    if not tests:
        return "photo", ""
    are = "is a test photo" if tests == 1 else "are test photos"
    return "training photo", f" ({tests} of the {count + tests} that see it {are})"
