"""Computes the coverage map of a box from a scene: surface, photos, places around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..context import QUIET, Context
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..model.visibility import find_candidates
from .box_map import BoxMap, box_map, usual_camera, with_sharpness
from .patches import surface_patches
from .photo_quality import PhotoQuality, measured
from .places import Places, standing_places
from .space import Space

ELSEWHERE = 2000  # points outside the box, to measure the sharpness of whole photos


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownBox:
    """The coverage of a box.

    Attributes:
        map: by patch and direction.
        places: from which it can be photographed.
        quality: of the map's photos, in their order; None: the photos were not read.
    """

    map: BoxMap
    places: Places
    quality: PhotoQuality | None


def known_box(
    scene: SfmScene, roi: OrientedBox, context: Context = QUIET, *, look: bool = True
) -> KnownBox:
    """Compute the map of a box; with `look`, the photos' sharpness is measured and included.

    RoiError: no point lies in the box, or no photo sees its points.
    """
    candidates = find_candidates(scene, roi, context)
    space = Space.of(scene, roi, context)
    patches = surface_patches(candidates, space, context)
    lens = usual_camera(candidates.images)
    places = standing_places(scene, candidates.images, roi, space, lens, context)
    ways = places.centres - roi.centre
    ways /= np.maximum(np.linalg.norm(ways, axis=1), 1e-300)[:, None]
    found = box_map(candidates, patches, space, ways, scene=scene, context=context)
    if not look:
        return KnownBox(map=found, places=places, quality=None)
    outside = scene.points[np.isfinite(scene.points).all(axis=1)]
    outside = outside[~roi.contains(outside)]
    others = outside[:: max(1, len(outside) // ELSEWHERE)]
    quality = measured(found.images, patches, found.seen, others, context)
    sharp = np.where(np.isfinite(quality.sharpness), quality.sharpness, 1.0)
    return KnownBox(map=with_sharpness(found, sharp, context), places=places, quality=quality)
