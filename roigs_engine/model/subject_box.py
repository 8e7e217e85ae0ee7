"""The box of `--roi auto`: around what most photos show, upright."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from ..errors import RoiError
from ..formats.subject import View, subject
from ..formats.upright import levelled
from .roi import OrientedBox
from .scene import SfmScene

NAME = "object"


def subject_box(scene: SfmScene) -> OrientedBox:
    """The box around what most photos show.

    Raises:
        RoiError: points or photos are too few to tell.
    """
    poses = np.array([image.world_to_camera for image in scene.images])
    transform = np.eye(4)
    transform[:3, :3] = levelled(poses)
    views = [View(pose=image.world_to_camera, **asdict(image.camera)) for image in scene.images]
    bounds = subject(views, scene.points, transform)
    if bounds is None or not (bounds[1] > bounds[0]).all():
        raise RoiError(
            "--roi auto finds no object: too few points are in the middle of the photos.",
            "Give --rois FILE or --roi NAME=x0,y0,z0,x1,y1,z1.",
        )
    low, high = bounds
    transform[:3, 3] = -(low + high) / 2
    return OrientedBox(name=NAME, world_to_box=transform, half_extents=(high - low) / 2)
