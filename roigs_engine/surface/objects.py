"""Separates objects from their support: their pixels, and the support's plane.

Masks of an object on some photos select its Gaussians, and these select its pixels on the other
photos. Depth of other objects carves space, but makes no surface. No photo shows the contact of
object and table, so the object is cut there along the plane of the table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..context import QUIET, Context
from ..model.gaussians import SH_C0, Gaussians
from ..model.roi import OrientedBox
from ..model.scene import Float64, SfmScene
from ..training.labels import object_owners
from .depth import DepthMap
from .fusion import TRUNCATION, Field

AROUND = 1.2  # of the box's size: so far the support is looked at
POINTS = 20_000  # of all photos, at most, of the object and of what is beside it
FEWEST = 200  # points of a support
PLANES = 500  # that are tried
THICK = 3.0  # voxels: how far points of the support are from its plane
SHARE = 0.3  # of the points beside the object, at least, are of its support
BELOW = 0.05  # of the object's points, at most, are below its support
ABOVE = 1.0  # voxels above the support: there the object begins


@dataclass(frozen=True, kw_only=True, eq=False)
class Support:
    """The plane that an object stands on: `normal @ place` is `height`, in the box's axes.

    Attributes:
        normal: (3,) unit vector to the object.
    """

    normal: Float64
    height: float


def has_masks(scene: SfmScene, roi: OrientedBox) -> bool:
    """Whether a photo has a mask of the box's object."""
    return any(roi.name in image.objects for image in scene.images)


def painted(
    gaussians: Gaussians, scene: SfmScene, roi: OrientedBox, context: Context = QUIET
) -> Gaussians:
    """The Gaussians, white where they are of the box's object by its masks, black elsewhere.

    Raises as `load_mask`.
    """
    rows = object_owners(gaussians, [roi], scene.images, context) == 0
    white = (rows.to(gaussians.means)[:, None, None] - 0.5) / SH_C0
    return gaussians.with_tensors({"sh": white.expand(-1, 1, 3).contiguous()})


def support_of(maps: Sequence[DepthMap], roi: OrientedBox, voxel: float) -> Support | None:
    """The support of the object, from depth maps with masks; None: no plane is below it.

    The plane with the most points beside the object, among those that have the object on one side
    (RANSAC, Fischler and Bolles 1981).
    """
    beside, own = _points(maps, roi, own=False), _points(maps, roi, own=True)
    if min(len(beside), len(own)) < FEWEST:
        return None
    rng = np.random.default_rng(0)
    best, most = None, SHARE * len(beside)
    for _ in range(PLANES):
        a, b, c = beside[rng.integers(len(beside), size=3)]
        plane = _plane(np.cross(b - a, c - a), a, own)
        if plane is None or (own @ plane.normal < plane.height - THICK * voxel).mean() > BELOW:
            continue
        near = np.abs(beside @ plane.normal - plane.height) < THICK * voxel
        if near.sum() > most:
            best, most = near, near.sum()
    if best is None:
        return None
    middle = beside[best].mean(axis=0)
    return _plane(np.linalg.svd(beside[best] - middle, full_matrices=False)[2][2], middle, own)


def cut_off(field: Field, support: Support) -> Field:
    """The field, free below the support of its object."""
    x, y, z = (
        (field.origin[k] + field.voxel * np.arange(n)) * support.normal[k]
        for k, n in enumerate(field.distance.shape)
    )
    foot = support.height + ABOVE * field.voxel
    distance = field.distance.copy()
    for k in range(len(x)):  # a slice at a time: no second field
        below = (foot - x[k] - y[:, None] - z) / (TRUNCATION * field.voxel)
        np.maximum(distance[k], np.clip(below, -1, 1), out=distance[k])
    return replace(field, distance=distance)


def _plane(normal: Float64, place: Float64, own: Float64) -> Support | None:
    length = float(np.linalg.norm(normal))
    if not length > 0:
        return None
    normal = normal / length
    if np.median(own @ normal) < place @ normal:
        normal = -normal
    return Support(normal=normal, height=float(place @ normal))


def _points(maps: Sequence[DepthMap], roi: OrientedBox, *, own: bool) -> Float64:
    """(N, 3) places of depths on the object, or beside it, in the box's axes."""
    found = []
    for depth_map in maps:
        y, x = np.nonzero((depth_map.depth > 0) & (depth_map.weight * (1 if own else -1) > 0))
        step = max(1, len(x) * len(maps) // POINTS)
        x, y = x[::step], y[::step]
        camera, z = depth_map.lens, depth_map.depth[y, x].astype(np.float64)
        rays = np.stack([(x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy], 1)
        to_box = roi.world_to_box @ np.linalg.inv(depth_map.world_to_camera)
        places = np.concatenate([rays * z[:, None], z[:, None]], axis=1)
        found.append(places @ to_box[:3, :3].T + to_box[:3, 3])
    places = np.concatenate(found)
    return np.asarray(places[(np.abs(places) < AROUND * roi.half_extents).all(axis=1)])
