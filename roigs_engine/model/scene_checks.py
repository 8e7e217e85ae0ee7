"""Checks a scene: removes outlier cameras and points, warns of poorly seen boxes.

Reconstruction places some cameras and points far away from all others. One such camera would set
the scale of the whole training. A far point becomes a huge Gaussian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .ownership import nearest_owner
from .roi import OrientedBox
from .scene import ONE_POSITION, Float64, PosedImage, SfmScene, project, reaches

STRAY = "with a camera far from all others"
OUTLIER_REACH = 10.0  # a camera farther than this (see `scene.reaches`) is suspect
FEW_POINTS = 10  # with fewer observed points, a suspect camera is an outlier
LEAST_EXTENT = 0.05  # of a photo's points: standard deviation as share of its width
FAR_POINT = 1000.0  # x cameras' extent or points' median distance: farther points are outliers


def without_outliers(scene: SfmScene) -> SfmScene:
    """Remove outlier cameras and points; they are recorded in `skipped` and `stray_points`.

    A camera far from the others is kept if the points that it observes fill its photo, as in a
    view from a drone. It is an outlier if they do not, or if the model has no tracks.
    """
    outlier = _outlier_cameras(scene)
    if outlier.any():
        images = tuple(image for image, bad in zip(scene.images, outlier, strict=True) if not bad)
        names = tuple(image.name for image, bad in zip(scene.images, outlier, strict=True) if bad)
        scene = replace(scene, images=images, skipped=scene.skipped | {STRAY: names})
    return _without_far_points(scene)


def _outlier_cameras(scene: SfmScene) -> NDArray[np.bool_]:
    """(V,) whether each photo's camera is an outlier."""
    centres = scene.centres()
    if len(centres) < 3:  # with two cameras, either may be wrong
        return np.zeros(len(centres), dtype=bool)
    far = reaches(centres) > OUTLIER_REACH
    if far.any() and len(scene.points):
        middle = np.median(centres, axis=0)
        away = float(np.median(np.linalg.norm(scene.points - middle, axis=1)))
        far &= np.linalg.norm(centres - middle, axis=1) > ONE_POSITION * away
    for row in np.flatnonzero(far):
        far[row] = not _shows_its_points(scene.images[row], scene.points)
    return far


def _shows_its_points(image: PosedImage, points: Float64) -> bool:
    """Whether the points that a photo observes project into it, and not all to one spot."""
    if len(image.point_indices) < FEW_POINTS:
        return False
    observed = points[image.point_indices]
    pixels, _, seen = project(observed, image.camera, image.world_to_camera)
    if 2 * seen.sum() < len(observed):
        return False
    spread = np.linalg.norm(pixels[seen].std(axis=0))
    return bool(spread >= LEAST_EXTENT * image.camera.width)


def _without_far_points(scene: SfmScene) -> SfmScene:
    """Remove points far from all cameras, and update `point_indices`."""
    centres = scene.centres()
    if not len(centres) or not len(scene.points):
        return scene
    distances = np.linalg.norm(scene.points - np.median(centres, axis=0), axis=1)
    usual = float(np.median(distances))
    if distances.max() <= FAR_POINT * usual:
        return scene
    # Cameras close together, as in a panorama, may see a wide scene.
    near = distances <= FAR_POINT * max(scene.extent(), usual)
    if near.all() or not near.any():
        return scene
    new_rows = np.cumsum(near) - 1
    images = tuple(
        replace(image, point_indices=new_rows[image.point_indices[near[image.point_indices]]])
        for image in scene.images
    )
    return replace(
        scene,
        images=images,
        points=scene.points[near],
        colors=scene.colors[near],
        stray_points=int((~near).sum()),
    )


FEW = 5  # photos of a box; with fewer, most of its surface is in at most one photo


def scene_warnings(scene: SfmScene, rois: Sequence[OrientedBox]) -> list[str]:
    """Warnings about boxes that own no point, one sentence each; empty if there are none."""
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
    """The warning about a box (its name) if too few photos see it; otherwise empty.

    `count`, `tests`: numbers of training and test photos that see it; `points`: in the box.
    """
    kind, others = kind_of_photos(count, tests)
    if points == 0:
        return [f"No point lies in box '{roi}': move it onto the object, or enlarge it."]
    if count == 0:
        return [f"No photo sees box '{roi}': move or enlarge it, or add photos of it."]
    if count >= FEW:
        return []
    who = f"one {kind} sees" if count == 1 else f"{count} {kind}s see"
    meaning = "that is too few to reconstruct an object."
    if count > 1:
        meaning = "it will look right only from their directions. Add photos of it."
    return [f"Only {who} box '{roi}'{others}: {meaning}"]


def kind_of_photos(count: int, tests: int) -> tuple[str, str]:
    """Words for messages: what to call a box's photos, and a remark on test photos.

    `count`, `tests`: numbers of training and test photos that see the box.
    """
    if not tests:
        return "photo", ""
    are = "is a test photo" if tests == 1 else "are test photos"
    return "training photo", f" ({tests} of the {count + tests} that see it {are})"
