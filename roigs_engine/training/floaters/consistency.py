"""Multi-view consistency: prunes floaters in front of boxes and hidden Gaussians in them (ours).

If only one or two photos show a Gaussian, it can lie anywhere along their rays without an error in
these photos. Close to a camera it hides the object in all views between the photos. So a Gaussian
nearer than the boxes, or in the air before the scene, is kept only if enough photos show it.
Farther away it is background, which few photos may show. A Gaussian that no photo shows is useless
in a box; elsewhere a new view may show it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ...context import QUIET, Context
from ...model.gaussians import Gaussians
from ...model.ownership import owners
from ...model.roi import OrientedBox
from ...model.scene import Float64, PosedImage
from ...rasterize.view import blending_weights
from ..densification.adaptive import VISIBLE_WEIGHT
from .view_shares import in_the_air

NEARER = 1.5  # times nearer to a camera than to the scene is in the air


@torch.no_grad()
def consistent_across_views(
    gaussians: Gaussians,
    images: Sequence[PosedImage],
    rois: Sequence[OrientedBox],
    points: Float64,
    min_views: int,
    context: Context = QUIET,
) -> Tensor:
    """(N,) bool: which Gaussians to keep.

    A photo shows a Gaussian where its alpha x T is 1/255 or more on some pixel.

    Args:
        gaussians: the model, N rows.
        images: the training photos; their pixels are not used.
        rois: the boxes.
        points: (P, 3) of the scene, world units; the photos' `point_indices` are rows of it.
        min_views: a Gaussian needs this number of photos that show it, or all photos if there are
            fewer, if it is nearer than the nearest box in each of them; or if it is in the air, and
            nearer than half of the points that the photo observes in each of them. In a photo that
            sees no box, or has no points, nothing is nearer.
        context: checked for cancellation between photos.
    """
    means = gaussians.means
    shown_by = torch.zeros(len(gaussians), dtype=torch.int32, device=means.device)
    before_boxes = torch.ones_like(shown_by, dtype=torch.bool)
    before_scene = before_boxes.clone()
    min_views = min(min_views, len(images))
    views = [(image.camera, image.world_to_camera) for image in images]
    for image, weights in zip(images, blending_weights(gaussians, views, context), strict=True):
        pose = torch.from_numpy(image.world_to_camera).to(means)
        shown = weights.largest >= VISIBLE_WEIGHT
        depth = means @ pose[2, :3] + pose[2, 3]
        shown_by += shown
        before_boxes &= ~shown | (depth < _nearest(rois, image))
        before_scene &= ~shown | (depth < _middle(points, image))
    in_front = before_boxes | (before_scene & in_the_air(gaussians, images, points, NEARER))
    floating = (shown_by > 0) & (shown_by < min_views) & in_front
    hidden = (shown_by == 0) & (owners(gaussians, rois) >= 0)
    return ~(floating | hidden)


def _nearest(rois: Sequence[OrientedBox], image: PosedImage) -> float:
    """Depth of the nearest corner of all boxes; negative if one is partly behind the camera.

    Minus infinity if the photo sees no box: nothing is nearer.
    """
    pose = image.world_to_camera
    if not any(roi.projected_area(image.camera, pose) for roi in rois):
        return -np.inf
    corners = np.concatenate([roi.corners() for roi in rois])
    return float((corners @ pose[2, :3] + pose[2, 3]).min())


def _middle(points: Float64, image: PosedImage) -> float:
    """Median depth of the points that the photo observes; minus infinity without any."""
    if len(points) == 0 or len(image.point_indices) == 0:
        return -np.inf
    pose = image.world_to_camera
    return float(np.median(points[image.point_indices] @ pose[2, :3] + pose[2, 3]))
