"""Input and output of selection methods, and photos' static features (paper, sec. III-A)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..formats.text import counted, named
from ..model.scene import Float64
from ..model.visibility import Candidates
from .score import Score


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
            f" ({named(names, 3)}): it is assumed to fill their images.",
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
        inside=roi.contains(candidates.centres()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Request:
    """The input of a method; `count` is the number of candidates to pick, at most all."""

    candidates: Candidates
    features: StaticFeatures
    count: int
    seed: int = 0
    context: Context = QUIET


@dataclass(frozen=True, kw_only=True)
class Picks:
    """The result of a method.

    Attributes:
        order: unique candidate ids, best first.
        flags: warnings about them.
        score: the method's score, reset to an empty set, if the method has one.
    """

    order: tuple[int, ...]
    flags: tuple[str, ...] = ()
    score: Score | None = field(default=None, compare=False, repr=False)
