"""Cameras and points that reconstruction has put far away from all others, by mistake.

One such camera would set the scale of the whole training; a far point becomes a huge Gaussian.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .scene import ONE_POSITION, Float64, PosedImage, SfmScene, reaches

STRAY = "with a camera far from all others"
STRAY_REACH = 10.0  # a camera farther than this (see `scene.reaches`) is suspect
FEW_POINTS = 10  # observed points that a photo needs to clear its camera
SPREAD = 0.05  # of the projected points over the photo, standard deviation as share of its width
FAR_POINT = 1000.0  # times the cameras' extent or the points' median distance: a stray point


def without_strays(scene: SfmScene) -> SfmScene:
    """The scene without stray cameras and points; see its `skipped` and `stray_points`.

    A camera far from the others is kept if the points that it observes fill its photo, as in a
    view from a drone; it is stray if they do not, or if the model has no tracks.
    """
    stray = _stray_cameras(scene)
    if stray.any():
        images = tuple(image for image, bad in zip(scene.images, stray, strict=True) if not bad)
        names = tuple(image.name for image, bad in zip(scene.images, stray, strict=True) if bad)
        scene = replace(scene, images=images, skipped=scene.skipped | {STRAY: names})
    return _without_far_points(scene)


def _stray_cameras(scene: SfmScene) -> NDArray[np.bool_]:
    """(V,) bool, one for each photo."""
    centres = scene.centres()
    if len(centres) < 3:  # of two, either may be the wrong one
        return np.zeros(len(centres), dtype=bool)
    far = reaches(centres) > STRAY_REACH
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
    camera = image.camera
    pixels, _ = image.projected(points[image.point_indices])
    inside = pixels[((pixels >= 0) & (pixels <= (camera.width, camera.height))).all(axis=1)]
    if 2 * len(inside) < len(image.point_indices):
        return False
    return bool(np.linalg.norm(inside.std(axis=0)) >= SPREAD * camera.width)


def _without_far_points(scene: SfmScene) -> SfmScene:
    """The scene without points far from all cameras; `point_indices` follow."""
    centres = scene.centres()
    if not len(centres) or not len(scene.points):
        return scene
    distances = np.linalg.norm(scene.points - np.median(centres, axis=0), axis=1)
    # Cameras close together, as of a panorama, may see a wide scene.
    near = distances <= FAR_POINT * max(scene.extent(), float(np.median(distances)))
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
