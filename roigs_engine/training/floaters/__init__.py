"""Floaters: Gaussians that hang in the air, which photos cannot judge (ours).

consistency     before the boxes or the scene, but in few photos; or in a box, but in no photo
between_views   fills a view between the photos, but no photo
among_cameras   hangs near a camera, where no photo looks
"""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from ...context import QUIET, Context
from ...model.gaussians import Gaussians
from ...model.roi import OrientedBox
from ...model.scene import Float64, PosedImage
from .among_cameras import hangs_among_cameras
from .between_views import fills_only_between, views_between
from .consistency import consistent_across_views
from .view_shares import largest_shares, photo_views

__all__ = ["floaters"]


def floaters(
    gaussians: Gaussians,
    images: Sequence[PosedImage],
    rois: Sequence[OrientedBox],
    points: Float64,
    min_views: int,
    context: Context = QUIET,
) -> Tensor:
    """(N,) bool: which Gaussians are floaters.

    Args:
        gaussians: the model, N rows.
        images: the training photos; their pixels are not used.
        rois: the boxes.
        points: (P, 3) of the scene, world units.
        min_views: see `consistent_across_views`.
        context: checked for cancellation between views.
    """
    found = ~consistent_across_views(gaussians, images, rois, points, min_views, context)
    shown = largest_shares(gaussians, photo_views(images), context)
    found |= fills_only_between(gaussians, views_between(images, points), shown, context)
    return found | hangs_among_cameras(gaussians, images, points, shown)
