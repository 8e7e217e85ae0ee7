"""`static`: the static features of photos, and their ranking by these (the paper's sec. III-A).

The features are distance, projected area and keypoints; the ranking is the paper's ablation 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..formats.text import counted, named
from ..model.scene import Float64
from ..model.visibility import Candidates
from .result import Picks


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticFeatures:
    """The features of the candidates, in their order.

    Attributes:
        distance: (V,) from the camera's centre to the box's centre, world units.
        area: (V,) share of the image in the box's silhouette, 0 to 1; 1 for a camera inside the
            box.
        keypoints: (V,) number of points in the box that the photo observes.
        inside: (V,) whether the camera's centre lies in the box.
    """

    distance: Float64
    area: Float64
    keypoints: Float64
    inside: NDArray[np.bool_]

    def flags(self, candidates: Candidates) -> tuple[str, ...]:
        """A warning if cameras are inside the box."""
        names = [n for n, inside in zip(candidates.names, self.inside, strict=True) if inside]
        if not names:
            return ()
        return (
            f"Box '{candidates.roi.name}' contains {counted(len(names), 'camera')}"
            f" ({named(names, 3)}), whose images it is taken to fill.",
        )

    def to_dict(self, candidates: Candidates) -> dict[str, dict[str, float]]:
        """Photo name -> feature name -> value."""
        columns = zip(candidates.names, self.distance, self.area, self.keypoints, strict=True)
        return {
            name: {"distance": float(d), "area": float(a), "keypoints": float(k)}
            for name, d, a, k in columns
        }


def static_features(candidates: Candidates, context: Context = QUIET) -> StaticFeatures:
    """The features of every candidate."""
    roi, images = candidates.roi, candidates.images
    area = []
    for image in images:
        context.check_cancelled()
        area.append(roi.projected_area(image.camera, image.world_to_camera))
    return StaticFeatures(
        distance=np.linalg.norm(candidates.centres() - roi.centre, axis=1),
        area=np.array(area),
        keypoints=np.bincount(candidates.obs_view, minlength=len(images)).astype(float),
        inside=np.array([roi.camera_inside(image.world_to_camera) for image in images]),
    )


def order_static(features: StaticFeatures, count: int) -> Picks:
    """The `count` photos with the best sum of ranks of -distance, area and keypoints.

    Equal values share their mean rank; names break ties (candidates are in name order).
    """
    ranks = _ranks(features.distance) + _ranks(-features.area) + _ranks(-features.keypoints)
    return Picks(order=tuple(np.argsort(ranks, kind="stable")[:count].tolist()))


def _ranks(values: Float64) -> Float64:
    """(V,) -> (V,) ranks from 1, ascending; equal values share their mean rank."""
    _, index, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks: Float64 = (np.cumsum(counts) - (counts - 1) / 2)[index]
    return ranks
