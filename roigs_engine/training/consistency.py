"""What the photos do not vouch for: floaters before the boxes, and what is buried in them (ours).

A Gaussian that one or two photos show can stand anywhere along their rays and still be right in
them. Standing close before a camera, it does no harm there, but hides the object from every view
that lies between the photos. So what stands nearer than the boxes is kept only if enough photos
show it; what stands farther away is background, which few photos may well show. What none shows is
useless in a box; elsewhere a new view may look at it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..cuda.device import CPU
from ..cuda.library import can_weigh
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from ..rasterize.view import rasterize_view
from .densify import VISIBLE_WEIGHT, box_owner


@torch.no_grad()
def vouched_for(
    gaussians: Gaussians,
    images: Sequence[PosedImage],
    rois: Sequence[OrientedBox],
    photos: int,
    context: Context = QUIET,
) -> Tensor:
    """(N,) bool: which Gaussians the photos vouch for.

    A photo shows a Gaussian where it has alpha x T of 1/255 or more on some pixel.

    Args:
        gaussians: the model, N rows.
        images: the training photos; their pixels are not looked at.
        rois: the boxes.
        photos: of those that a photo shows, what stands nearer than the nearest box in each such
            photo must be shown by so many, or by all where there are fewer. Only photos with a box
            in sight say what is nearer than a box.
        context: asked between photos whether to stop.
    """
    device = gaussians.means.device
    model = gaussians if can_weigh(device) else gaussians.to(CPU)
    shown_by = torch.zeros(len(model), dtype=torch.int32, device=model.means.device)
    in_front = torch.ones_like(shown_by, dtype=torch.bool)
    photos = min(photos, len(images))
    for image in images:
        context.check_cancelled()
        pose = torch.from_numpy(image.world_to_camera).to(model.means)
        output = rasterize_view(
            model,
            image.camera,
            image.world_to_camera,
            sh_degree=0,  # colours do not matter
            with_max_weight=True,
        )
        assert output.max_weight is not None
        shown = output.max_weight >= VISIBLE_WEIGHT
        depth = model.means @ pose[2, :3] + pose[2, 3]
        shown_by += shown
        in_front &= ~shown | (depth < _nearest(rois, image))
    floating = (shown_by > 0) & (shown_by < photos) & in_front
    buried = (shown_by == 0) & (box_owner(model, rois) >= 0)
    return ~(floating | buried).to(device)


def _nearest(rois: Sequence[OrientedBox], image: PosedImage) -> float:
    """Depth of the nearest corner of all boxes; negative where one lies partly behind.

    Below all depths where the photo has no box in sight, and thus nothing before one.
    """
    pose = image.world_to_camera
    if not any(roi.projected_area(image.camera, pose) for roi in rois):
        return -np.inf
    corners = np.concatenate([roi.corners() for roi in rois])
    return float((corners @ pose[2, :3] + pose[2, 3]).min())
