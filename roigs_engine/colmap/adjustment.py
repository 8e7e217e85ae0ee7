"""Bundle adjustments (Triggs et al. 2000) of pycolmap's reconstructions, and what they leave."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from ..model.scene import Float64

Observation = tuple[int, int, int]
"""Ids of the photo, of its keypoint, and of the point."""

FEWEST_OBSERVATIONS = 10  # of a photo whose camera may move: fewer could send it anywhere
LEFT_OUT_EVERY = 3  # points
FEWEST_LEFT_OUT = 50  # observations to compare by
LONG_TRACK = 4  # observations; of a shorter one, none can be left out
ITERATIONS = 20  # it settles in ten


def adjust(
    colmap: Any,
    scene: Any,
    loss: str,
    scale: float,
    *,
    points_only: bool = False,
    distortion: bool = True,
) -> None:
    """Find the cameras, poses and points that fit the tracks best.

    Args:
        colmap: the module pycolmap.
        scene: its reconstruction; changed.
        loss, scale: pycolmap's name of the loss; from how many px on it counts errors less.
        points_only: leave cameras and poses as they are.
        distortion: whether the lenses' distortion may change.
    """
    options = colmap.BundleAdjustmentOptions()
    solver = getattr(options, "ceres", options)  # where pycolmap has these, since 4 and before
    options.print_summary = False
    solver.loss_function_type = getattr(colmap.LossFunctionType, loss)
    solver.loss_function_scale = scale
    solver.solver_options.max_num_iterations = ITERATIONS
    options.refine_focal_length = options.refine_sensor_from_rig = not points_only
    options.refine_extra_params = distortion and not points_only
    config = colmap.BundleAdjustmentConfig()
    for key in scene.reg_image_ids():
        image = scene.images[key]
        if sum(keypoint.has_point3D() for keypoint in image.points2D) < FEWEST_OBSERVATIONS:
            continue
        config.add_image(key)
        if points_only:
            config.set_constant_rig_from_world_pose(image.frame_id)
    colmap.create_default_bundle_adjuster(options, config, scene).solve()


def to_leave_out(scene: Any, anchors: Collection[tuple[int, int]] = ()) -> list[Observation]:
    """One observation of every third point with a long track, to judge an adjustment by.

    Args:
        scene: pycolmap's reconstruction.
        anchors: ids of photos and keypoints that must stay.
    """
    found = []
    lengths = {key: len(scene.points3D[key].track.elements) for key in scene.point3D_ids()}
    points = [key for key in sorted(lengths) if lengths[key] >= LONG_TRACK]
    for number, point in enumerate(points[::LEFT_OUT_EVERY]):
        elements = scene.points3D[point].track.elements
        first = number % len(elements)
        for element in (*elements[first:], *elements[:first]):
            if (element.image_id, element.point2D_idx) not in anchors:
                found.append((element.image_id, element.point2D_idx, point))
                break
    return found


def median_error(scene: Any, observations: Sequence[Observation]) -> float:
    """Median distance of keypoints from where their points appear, px."""
    return float(np.median(errors(scene, observations)))


def errors(scene: Any, observations: Sequence[Observation]) -> Float64:
    """(M,) distances of keypoints from where their points appear, px; infinite: nowhere."""
    found = np.full(len(observations), np.inf)
    for row, (image, keypoint, point) in enumerate(observations):
        photo = scene.images[image]
        seen = photo.project_point(scene.points3D[point].xyz)
        if seen is not None:
            found[row] = np.linalg.norm(photo.points2D[keypoint].xy - seen)
    return found
