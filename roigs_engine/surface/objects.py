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

AROUND = 1.2  # size of the region in which a support is searched, in sizes of the box
POINTS = 20_000  # about how many points of all photos, on the object, and beside it
FEWEST = 200  # least number of points, on the object, and beside it
PLANES = 500  # planes that are tried
THICK = 3.0  # most distance of the support's points from its plane, voxels
SHARE = 0.3  # least share of the points beside the object that are on its support
BELOW = 0.05  # largest share of the object's points below its support
ABOVE = 1.0  # height above the support at which the object begins, voxels


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
    """Paint the Gaussians white if masks assign them to the box's object, else black.

    Raises the errors of `load_mask`.
    """
    rows = object_owners(gaussians, [roi], scene.images, context) == 0
    white = (rows.to(gaussians.means)[:, None, None] - 0.5) / SH_C0
    return gaussians.with_tensors({"sh": white.expand(-1, 1, 3).contiguous()})


def support_of(maps: Sequence[DepthMap], roi: OrientedBox, voxel: float) -> Support | None:
    """Find the support of an object from depth maps with masks; None if no plane is below it.

    Among planes with the object on one side, it is the one with the most points beside the object
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
    """Return the field with free space below the support of its object."""
    x, y, z = (
        (field.origin[k] + field.voxel * np.arange(n)) * support.normal[k]
        for k, n in enumerate(field.distance.shape)
    )
    foot = support.height + ABOVE * field.voxel
    distance = field.distance.copy()
    for k in range(len(x)):  # a slice at a time, because a second field would take memory
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
    """Return places (N, 3) of depths on the object, or beside it, in the box's axes."""
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
